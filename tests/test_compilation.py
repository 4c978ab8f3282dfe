"""Stored machine code: used only while it is what its sources say, and stored where that works."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

import crowdbench

PACKAGE = Path(crowdbench.__file__).parent
REPORT = """
import atexit, numba.core.event as event
class Listener(event.Listener):
    def on_start(self, started): pass
    def on_end(self, ended): names.add(ended.data["dispatcher"].py_func.__name__)
names = set()
event.register("numba:compile", Listener())
"""


def copy_of_the_package(folder: Path) -> Path:
    """A copy of the package without its machine code, whose sources can be changed."""
    leave = shutil.ignore_patterns("__pycache__", "studies", "_scenes")
    shutil.copytree(PACKAGE, folder / "crowdbench", ignore=leave)
    return folder / "crowdbench"


def run(code: str, package: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in another process, with a copy of the package or the package itself."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=kept | {"PYTHONPATH": str(package.parent)} | environment,
        capture_output=True,
        text=True,
        check=False,
        cwd=package.parent,
    )


INNER = (
    "from numba import njit\n"
    "from crowdbench.compilation import compiled\n"
    "from crowdbench.constants import FACTOR\n"
    "@njit\n"
    "def scaled(x):\n"
    '    """{docstring}"""\n'
    "    return FACTOR * x\n"
    "@compiled{options}\n"
    "def outer(x):\n"
    "    return scaled(x) + 1.0\n"
)


@pytest.mark.long
def test_machine_code_is_made_anew_exactly_when_what_it_is_made_from_changes(
    tmp_path: Path,
) -> None:
    package = copy_of_the_package(tmp_path)

    def outcome(factor: float, docstring: str = "Scaled.", options: str = "") -> str:
        (package / "constants.py").write_text(f"FACTOR = {factor}  # {docstring}\n")
        (package / "inner.py").write_text(INNER.format(docstring=docstring, options=options))
        code = REPORT + "from crowdbench import inner\nprint(inner.outer(2.0), len(names))\n"
        done = run(code, package, PYTHONDONTWRITEBYTECODE="1")
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert outcome(3.0) == "7.0 2"
    assert outcome(3.0) == "7.0 0"  # stored
    assert outcome(4.0) == "9.0 2"  # a constant of another file
    assert outcome(4.0, docstring="Other words.") == "9.0 0"
    assert outcome(4.0, options='(error_model="python")') == "9.0 2"
    (package / "colours.py").write_text("UNUSED = 1\n")  # a module that it does not import
    assert outcome(4.0, options='(error_model="python")') == "9.0 0"


@pytest.mark.long
def test_machine_code_of_functions_of_other_packages_is_not_stored(tmp_path: Path) -> None:
    (tmp_path / "inner.py").write_text(
        "from crowdbench.compilation import compiled\n"
        "@compiled\n"
        "def outer(x):\n"
        "    return x + 1.0\n"
    )
    path = f"{tmp_path}{os.pathsep}{PACKAGE.parent}"
    code = REPORT + "import inner\nprint(inner.outer(2.0), len(names))\n"
    for _ in range(2):
        done = run(code, PACKAGE, PYTHONPATH=path)
        assert (done.returncode, done.stdout) == (0, "3.0 1\n"), done.stderr


WALK = """
from crowdbench import rollout, load_scene, spawn_model
from crowdbench.policies import Straight
crowd = rollout(load_scene("plaza-v0"), spawn_model("poisson-gmm", "plaza-v0"), Straight(), seed=0,
                horizon_s=8.0, start="empty")
print(len(crowd.xy), "step" if "advance_alone" in names else "")
"""


@pytest.mark.long
def test_a_constant_of_plans_reaches_the_compiled_step(tmp_path: Path) -> None:
    package = copy_of_the_package(tmp_path)
    shutil.copytree(PACKAGE.parent / "scenes", tmp_path / "scenes")
    code = REPORT + WALK
    assert run(code, package).stdout.endswith("step\n")
    assert not run(code, package).stdout.endswith("step\n")
    plans = package / "spawn" / "recorded_plans.py"
    source = plans.read_text()
    assert "VISIT_M = 1.0\n" in source
    plans.write_text(source.replace("VISIT_M = 1.0\n", "VISIT_M = 1.5\n"))
    assert run(code, package).stdout.endswith("step\n")
    scoring = package / "scoring" / "energy.py"
    scoring.write_text(scoring.read_text() + "\nUNUSED = 1\n")
    assert not run(code, package).stdout.endswith("step\n")


class Old(NamedTuple):
    first: np.ndarray
    second: np.ndarray


class New(NamedTuple):
    second: np.ndarray
    first: np.ndarray


def test_machine_code_depends_on_the_fields_of_named_tuples() -> None:
    from crowdbench.compilation import _fields

    old, new = (numba.typeof((kind(np.zeros(2), np.zeros(2)), 1)) for kind in (Old, New))
    assert list(_fields((old,))) == [("first", "second")]
    assert list(_fields((new,))) == [("second", "first")]


@pytest.mark.long
def test_code_for_a_named_tuple_that_has_been_renamed_is_made_anew(tmp_path: Path) -> None:
    package = copy_of_the_package(tmp_path)
    (package / "kernels.py").write_text(
        "from crowdbench.compilation import compiled\n"
        "@compiled\n"
        "def twice(pair):\n"
        "    return 2.0 * pair.one\n"
    )
    for name in ("Pair", "Couple"):
        (package / "tuples.py").write_text(
            f"from typing import NamedTuple\nclass {name}(NamedTuple):\n    one: float\n"
        )
        code = f"from crowdbench import kernels, tuples; print(kernels.twice(tuples.{name}(1.5)))"
        done = run(code, package, PYTHONDONTWRITEBYTECODE="1")
        assert (done.returncode, done.stdout) == (0, "3.0\n"), done.stderr


@pytest.mark.long
def test_it_works_where_no_folder_can_be_written(tmp_path: Path) -> None:
    """Modules lie in a folder that takes no machine code, and there is no home."""
    package = copy_of_the_package(tmp_path)
    (package / "constants.py").write_text("FACTOR = 3.0\n")
    (package / "inner.py").write_text(INNER.format(docstring="Scaled.", options=""))
    for folder in (p.parent for p in package.rglob("__init__.py")):
        (folder / "__pycache__").write_text("no folder")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    code = "import crowdbench.simulation\nfrom crowdbench import inner\nprint(inner.outer(2.0))"
    without = {"HOME": "/dev/null", "PYTHONDONTWRITEBYTECODE": "1", "TMPDIR": str(temporary)}
    done = run(code, package, **without)
    assert (done.returncode, done.stdout) == (0, "7.0\n"), done.stderr
    assert "at each start" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr
    assert not list(temporary.iterdir())
    nowhere = "import tempfile\ntempfile.mkdtemp = lambda **_: (_ for _ in ()).throw(OSError)\n"
    done = run(nowhere + code, package, **without)
    assert (done.returncode, done.stdout) == (0, "7.0\n"), done.stderr
