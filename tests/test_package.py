"""What a wheel carries."""

import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_wheel_carries_the_scenes_and_the_types(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
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
