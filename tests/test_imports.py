"""What imports what: each floor from lower ones only, and light uses stay light."""

import ast
import statistics
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import crowdbench

PACKAGE = Path(crowdbench.__file__).parent

FLOORS = (
    ("baselines", "code", "colours", "errors", "progress"),  # of baselines, the package alone
    ("compilation", "files", "plugins"),
    ("data", "scene"),
    ("metrics", "spawn"),
    ("scoring", "simulation"),
    ("policies",),
    ("registry",),
    ("run",),
    ("report", "viewer"),
    ("envs", "exam"),
    ("crowds", "evaluation", "leaderboard", "robot", "scene_building"),
    ("cli",),
    ("__main__",),
)
"""Who stands on a floor imports from those above it in this list, and nothing beside itself."""
ROOMS = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
SHORT_NAMES = ("cards", "torchrl_env", "vec_env")
"""Modules that only pass on names which the documentation uses; nothing here imports them."""
HEAVY = (
    "torch",
    "onnx",
    "onnxruntime",
    "sklearn",
    "pyarrow",
    "rerun",
    "pedpy",
    "numba",
    "matplotlib",
    "gymnasium",
    "pettingzoo",
    "requests",
)


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) in (
        "TYPE_CHECKING", "typing.TYPE_CHECKING",
    )  # fmt: skip


def run_time_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes that run, those inside functions included."""
    for child in ast.iter_child_nodes(node):
        if is_type_checking(child):
            assert isinstance(child, ast.If)
            for other in child.orelse:
                yield other
                yield from run_time_nodes(other)
        else:
            yield child
            yield from run_time_nodes(child)


def imported(code: str) -> set[str]:
    """Parts of crowdbench that the code imports."""
    names: list[str] = []
    for node in run_time_nodes(ast.parse(code)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            whole = node.module == "crowdbench"
            names += (
                [f"{node.module}.{a.name}" for a in node.names] if whole else [str(node.module)]
            )
    return {n.split(".")[1] for n in names if n.startswith("crowdbench.")} - {"__version__"}


def part_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


MODULES = sorted(
    p
    for p in PACKAGE.rglob("*.py")
    if p.parent != PACKAGE or p.stem not in ("__init__", *SHORT_NAMES)
)


def test_every_room_has_a_floor() -> None:
    assert {part_of(path) for path in MODULES} == set(ROOMS)
    assert len(FLOORS) <= 13


def test_few_modules_stand_beside_the_rooms() -> None:
    assert len([p for p in PACKAGE.glob("*.py") if p.stem not in SHORT_NAMES]) <= 12


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_import_only_from_lower_floors(path: Path) -> None:
    room = part_of(path)
    own = {room} if (PACKAGE / room).is_dir() else set()
    assert imported(path.read_text()) - own <= {r for r in ROOMS if ROOMS[r] < ROOMS[room]}


def test_no_modules_import_each_other_in_a_circle() -> None:
    names = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in MODULES}
    needs: dict[str, set[str]] = {}
    for path in MODULES:
        nodes = [
            n for n in run_time_nodes(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)
        ]
        parts = {f"{n.module}.{alias.name}" for n in nodes for alias in n.names}
        name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        needs[name] = ({str(n.module) for n in nodes} | parts) & names
    assert "crowdbench.run.ray_executor" in needs["crowdbench.run.executor"]
    TopologicalSorter(needs).prepare()  # raises CycleError


@pytest.mark.parametrize("name", SHORT_NAMES)
def test_short_names_pass_on_and_nothing_else(name: str) -> None:
    _, *imports = ast.parse((PACKAGE / f"{name}.py").read_text()).body
    assert all(isinstance(node, ast.ImportFrom) for node in imports)


def test_modules_are_short() -> None:
    lines = [len(path.read_text().splitlines()) for path in PACKAGE.rglob("*.py")]
    assert max(lines) <= 400
    assert statistics.median(lines) <= 150


def test_only_who_shows_something_imports_the_viewer() -> None:
    users = {part_of(path) for path in MODULES if "viewer" in imported(path.read_text())}
    assert users == {"viewer", "envs", "robot", "cli"}


def test_the_walk_sees_imports_in_functions_and_not_those_for_types() -> None:
    code = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    from crowdbench.cli import main\n"
        "else:\n    import crowdbench.files\n"
        "def f():\n    from crowdbench import bench, __version__\n"
    )
    assert imported(code) == {"files", "bench"}


def loaded_by(code: str, cwd: Path | None = None) -> set[str]:
    """Names of the modules that a fresh interpreter has loaded after running the code."""
    code += "\nimport sys; print('\\n'.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=cwd
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines())


def test_importing_crowdbench_loads_nothing_heavy() -> None:
    assert loaded_by("import crowdbench") & set(HEAVY) == set()


def test_only_a_download_loads_what_it_needs() -> None:
    code = (
        "from crowdbench import cli\n"
        "import crowdbench.data.recordings.fetch\n"
        "cli.main(['data', 'list'])"
    )
    assert "requests" not in loaded_by(code)


def test_spawn_models_load_neither_numba_nor_torch_before_they_need_them() -> None:
    assert loaded_by("import crowdbench.spawn") & {"numba", "torch", "safetensors"} == set()


def test_sampling_the_neural_model_needs_no_torch() -> None:
    loaded = loaded_by(
        "import crowdbench, numpy\n"
        "scene = crowdbench.load_scene('plaza-v0')\n"
        "model = crowdbench.spawn_model('ntpp-gmm', scene)\n"
        "model.sample(40.0, scene, numpy.random.default_rng(0))"
    )
    assert "numba" in loaded
    assert "torch" not in loaded


def test_listing_scenes_loads_nothing_heavy() -> None:
    loaded = loaded_by("import crowdbench; crowdbench.load_scene(crowdbench.list_scenes()[0])")
    assert loaded & set(HEAVY) == set()


def test_scoring_a_table_loads_neither_torch_nor_the_simulation(tmp_path: Path) -> None:
    rows = "\n".join(f"0,{frame},1.0,2.0" for frame in range(1934))
    (tmp_path / "mine.csv").write_text(f"person_id,frame,x,y\n{rows}\n")
    loaded = loaded_by(
        "import crowdbench\n"
        "crowd = crowdbench.read('mine.csv', 'eth-v0')\n"
        "crowdbench.score('eth-v0', crowd)",
        cwd=tmp_path,
    )
    assert "crowdbench.scoring.reference" in loaded
    assert loaded & {"torch", "crowdbench.simulation"} == set()


def test_the_environment_needs_no_torch() -> None:
    loaded = loaded_by("import crowdbench; crowdbench.parallel_env('plaza-v0').reset(seed=0)")
    assert "pettingzoo" in loaded
    assert loaded & {"torch", "matplotlib", "rerun", "pyarrow", "crowdbench.viewer"} == set()


def test_pictures_need_neither_matplotlib_nor_rerun() -> None:
    loaded = loaded_by(
        "import crowdbench\n"
        "env = crowdbench.parallel_env('plaza-v0', render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "env.render()"
    )
    assert "PIL" in loaded
    assert loaded & {"torch", "matplotlib", "rerun", "pyarrow"} == set()


@pytest.mark.parametrize("name", crowdbench.__all__)
def test_each_public_name_is_there(name: str) -> None:
    assert getattr(crowdbench, name) is not None


def test_unknown_names_are_no_attributes() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = crowdbench.nothing


def test_public_names_are_listed() -> None:
    assert set(crowdbench.__all__) <= set(dir(crowdbench))
