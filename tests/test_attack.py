"""`make attack` runs; what it tries is tested elsewhere."""

import subprocess
import sys
from pathlib import Path

import attack

HERE = Path(__file__).parent


def test_every_kind_has_its_tests() -> None:
    assert all((HERE / name).is_file() for files in attack.KINDS.values() for name in files)


def test_it_counts_what_was_held_and_what_was_not(tmp_path: Path) -> None:
    """In a process of its own, as pytest is started in it."""
    (tmp_path / "test_one.py").write_text(
        "def test_held(): pass\ndef test_broken(): assert False\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(HERE)!r}); import attack\n"
        "attack.KINDS = {"
        f"'names': ('test_nearest_names.py',), 'one': ({str(tmp_path / 'test_one.py')!r},)}}\n"
        "attack.killed = lambda: attack.Tried(missing=1)\n"
        "sys.exit(attack.main())"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True
    )
    assert ran.returncode == 1, ran.stderr[-2000:]
    lines = [line.split() for line in ran.stdout.splitlines()]
    assert ["one", "2", "1", "1", "0"] in lines
    names = next(line for line in lines if line[:1] == ["names"])
    assert int(names[1]) == int(names[2]) > 0
    assert "not held: " in ran.stdout
