"""What a wheel carries, and that it works where nothing of the repository is."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

ENTRIES = ROOT / "leaderboard" / "entries"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_carries_the_scenes_and_the_types(wheel: Path) -> None:
    carried = set(zipfile.ZipFile(wheel).namelist())
    scenes = {
        f"crowdbench/_scenes/{path.relative_to(ROOT / 'scenes').as_posix()}"
        for path in (ROOT / "scenes").rglob("*.*")
    }
    assert len(scenes) >= 8
    assert scenes | {"crowdbench/py.typed"} <= carried
    assert {name.split("/")[0] for name in carried} == {
        "crowdbench",
        f"{wheel.name.split('-py3')[0]}.dist-info",
    }
    board = {name for name in carried if name.startswith("crowdbench/_leaderboard/")}
    assert board == {f"crowdbench/_leaderboard/entries/{path.name}" for path in ENTRIES.glob("*")}
    assert {name for name in carried if name.startswith("crowdbench/baselines/")} == {
        f"crowdbench/baselines/{path.name}" for path in (ROOT / "baselines").glob("*.*")
    }


@pytest.mark.long
def test_the_source_distribution_makes_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path)]
    subprocess.run([*build, "-t", "sdist"], cwd=ROOT, check=True, capture_output=True)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    subprocess.run([*build, "-t", "wheel"], cwd=unpacked, check=True, capture_output=True)
    (again,) = tmp_path.glob("*.whl")
    assert contents(again) == contents(wheel)


def contents(wheel: Path) -> dict[str, int]:
    return {file.filename: file.CRC for file in zipfile.ZipFile(wheel).infolist()}


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """A Python outside the repository in which the wheel is installed; dependencies are shared."""
    venv = wheel.parent / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    scripts = Path(sysconfig.get_path("scripts", "venv", {"base": str(venv)}))
    packages = Path(sysconfig.get_path("purelib", "venv", {"base": str(venv)}))
    python = scripts / f"python{Path(sys.executable).suffix}"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps"]
    subprocess.run([*install, "--no-index", str(wheel)], check=True, capture_output=True)
    # Python ignores .pth files in folders that a .pth file names, such as an editable install's.
    (packages / "needed.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return python


def run(program: Path, *arguments: str, folder: Path) -> str:
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [program, *arguments], cwd=folder, env=plain, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_baselines_come_with_an_installed_wheel(installed: Path, tmp_path: Path) -> None:
    code = (
        "from crowdbench import baselines, policy; print(baselines.__file__); "
        "print(policy('crowdbench.baselines.heuristic:Heuristic', 'plaza-v0').name)"
    )
    ours, name = run(installed, "-c", code, folder=tmp_path).split()
    packages = next(installed.parents[1].rglob("needed.pth")).parent
    assert Path(ours) == packages / "crowdbench" / "baselines" / "__init__.py"
    assert name == "heuristic"


@pytest.mark.parametrize(
    ("code", "missing", "hint"),
    [
        (
            "from crowdbench.run.executor import engine; engine('ray').__enter__()",
            "ray",
            'Run pip install "crowdbench[ray]".',
        ),
        (
            "from crowdbench.scene_building.fit import check_torch; check_torch('Or not.')",
            "torch",
            'Run pip install "crowdbench[fit]". Or not.',
        ),
        (
            "import crowdbench.baselines.bc",
            "torch",
            "Run python -m venv .venv-imitation && .venv-imitation/bin/pip install "
            '"WHEEL[imitation,onnx]", where WHEEL is the file of crowdbench\'s wheel.',
        ),
    ],
)
def test_an_installed_wheel_says_how_to_install_extras(
    installed: Path, tmp_path: Path, code: str, missing: str, hint: str
) -> None:
    without = (
        "import importlib.util, sys\n"
        f"sys.modules[{missing!r}] = None\n"
        "find = importlib.util.find_spec\n"
        f"importlib.util.find_spec = lambda name: None if name == {missing!r} else find(name)\n"
        "from crowdbench.errors import SettingError\n"
        f"try:\n    {code}\nexcept SettingError as error:\n    print(error.hint)"
    )
    assert run(installed, "-c", without, folder=tmp_path).strip().endswith(hint)


def test_messages_say_what_is_possible_outside_a_clone_too() -> None:
    files = [*(ROOT / "crowdbench").rglob("*.py"), *(ROOT / "baselines").glob("*.py")]
    saying = [
        path.name for path in files if re.search(r"pip install|in the clone", path.read_text())
    ]
    assert saying == ["errors.py"]


def test_another_package_may_be_called_baselines(installed: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    (tmp_path / "baselines").mkdir()
    (tmp_path / "baselines" / "__init__.py").write_text("raise RuntimeError('not ours')\n")
    asked = ["-m", "crowdbench.baselines.anticipate", "--help"]
    told = run(installed, *asked, folder=tmp_path)
    assert told.startswith("usage: python -m crowdbench.baselines.anticipate")


@pytest.mark.nightly
def test_an_installed_wheel_trains_in_worker_processes(installed: Path, tmp_path: Path) -> None:
    pytest.importorskip("torchrl")
    asked = ["-m", "crowdbench.baselines.ppo", "--scene", "plaza-v0", "--splits", "fold0", "fold1"]
    brief = ["--workers", "2", "--frames", "800", "--batch-frames", "400", "--worlds", "2"]
    out = run(installed, *asked, *brief, folder=tmp_path)
    for split in ("fold0", "fold1"):
        file = Path("results", "ppo-plaza-v0", f"{split}.onnx")
        assert f"{file}: " in out
        assert (tmp_path / file).is_file()


@pytest.mark.long
def test_an_installed_wheel_evaluates(installed: Path, tmp_path: Path) -> None:
    pairs = ["--spawn", "poisson-gmm", "--policy", "straight", "--seeds", "1", "--workers", "1"]
    asked = ["-m", "crowdbench", "evaluate", "plaza-v0", *pairs, "--out", "found"]
    assert "poisson-gmm" in run(installed, *asked, folder=tmp_path)
    card = json.loads((tmp_path / "found" / "scorecard.json").read_text())
    assert card["entries"][0]["metrics"]["inter_spawn"]["distance"] > 0
    assert (tmp_path / "found" / "report.html").is_file()


def test_an_installed_wheel_shows_the_shipped_entries(installed: Path, tmp_path: Path) -> None:
    out = run(installed, "-m", "crowdbench", "leaderboard", "show", "bc", folder=tmp_path)
    assert "bc (ranked)" in out
