"""Rollouts are kept as long as what makes them is unchanged, and no longer."""

import shutil
from pathlib import Path

import pytest

from crowdbench.run import resolved
from crowdbench.run.resolved import fingerprint
from crowdbench.scene import load_scene

PACKAGE = Path(resolved.__file__).parents[1]


@pytest.mark.parametrize(
    ("file", "kept"),
    [
        ("report/html/tables.py", True),
        ("metrics/motion.py", True),
        ("cli/evaluate.py", True),
        ("scoring/energy.py", True),
        ("simulation/rules.py", False),
        ("spawn/renewal.py", False),
        ("policies/social_force.py", False),
        ("trajectories/table.py", False),
        ("registry/policies.py", False),
    ],
)
def test_a_change_of_the_code_that_makes_rollouts_makes_them_stale(
    file: str, kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "crowdbench"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(resolved, "__file__", str(copy / "evaluation" / "resolved.py"))
    scene = load_scene("plaza-v0")
    before = fingerprint(scene, "a rollout")
    (copy / file).write_text((copy / file).read_text() + "# another word\n")
    assert (fingerprint(scene, "a rollout") == before) == kept
