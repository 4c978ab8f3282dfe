"""Rollouts are kept as long as what makes them is unchanged, and no longer."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import crowdbench
from crowdbench import code
from crowdbench.run.resolved import (
    MAKES_ROLLOUTS,
    MODELS,
    PREPARE_RECORDINGS,
    TRAINING,
    Resolved,
)
from crowdbench.scene import Scene, load_scene

PACKAGE = Path(crowdbench.__file__).parent
PAIRS = [
    ("replay", "straight"),
    ("block-replay", "social-force"),
    ("poisson-gmm", "random"),
    ("poisson-gmm", "speed-model"),
    ("poisson-gmm", "guided-walker"),
    ("renewal-gmm", "straight"),
    ("cox-gmm", "straight"),
    ("cox-plans", "straight"),
    ("ntpp-gmm", "anticipate-any"),
    ("cox-gmm", "crowdbench.baselines.orca:ORCA"),
]
ALL = {f"{spawn} {policy}" for spawn, policy in PAIRS}


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The root of a copy of the code, which is hashed in place of the real one."""
    without = shutil.ignore_patterns("__pycache__", "*.html", "*.js")
    shutil.copytree(PACKAGE, tmp_path / "crowdbench", ignore=without)
    shutil.copytree(PACKAGE.parent / "baselines", tmp_path / "baselines", ignore=without)
    monkeypatch.setattr(code, "_ROOT", tmp_path)
    return tmp_path


def fingerprints(scene: Scene) -> dict[str, str]:
    code._code_hash.cache_clear()
    code._module.cache_clear()
    code._file.cache_clear()
    return {f"{s} {p}": Resolved.of(scene, s, p).fingerprint("full") for s, p in PAIRS}


def changed(before: dict[str, str], after: dict[str, str]) -> set[str]:
    return {pair for pair in before if before[pair] != after[pair]}


@pytest.mark.parametrize(
    ("file", "old", "new", "voids"),
    [
        ("simulation/step.py", '"""', '"""Other words. ', set()),
        ("simulation/rules.py", "", "# another word\n", set()),
        ("simulation/state.py", "", "ANOTHER = 1\n", ALL),
        ("run/episode.py", "", "ANOTHER = 1\n", ALL),
        ("data/table.py", "", "ANOTHER = 1\n", ALL),
        ("registry/policies.py", "", "ANOTHER = 1\n", ALL),
        ("metrics/motion.py", "", "ANOTHER = 1\n", set()),
        ("scoring/energy.py", "", "ANOTHER = 1\n", set()),
        ("report/html/tables.py", "", "ANOTHER = 1\n", set()),
        ("errors.py", "", "ANOTHER = 1\n", set()),
        ("data/recordings/gc.py", "", "ANOTHER = 1\n", set()),
        ("spawn/ntpp/training.py", "", "ANOTHER = 1\n", set()),
        ("spawn/times/renewal.py", "", "ANOTHER = 1\n", {"renewal-gmm straight"}),
        ("spawn/ntpp/kernels.py", "", "ANOTHER = 1\n", {"ntpp-gmm anticipate-any"}),
        ("spawn/plans/files.py", "", "ANOTHER = 1\n", {"cox-plans straight"}),
        ("spawn/block_replay.py", "", "ANOTHER = 1\n", {"block-replay social-force"}),
        ("policies/speed_model.py", "", "ANOTHER = 1\n", {"poisson-gmm speed-model"}),
        ("policies/guided.py", "", "ANOTHER = 1\n", {"poisson-gmm guided-walker"}),
        ("policies/network.py", "", "ANOTHER = 1\n", {"ntpp-gmm anticipate-any"}),
        ("../baselines/orca.py", "", "ANOTHER = 1\n", {"cox-gmm crowdbench.baselines.orca:ORCA"}),
    ],
)
def test_a_change_of_code_voids_what_runs_it(
    copied: Path, file: str, old: str, new: str, voids: set[str]
) -> None:
    scene = load_scene("plaza-v0")
    before = fingerprints(scene)
    path = copied / "crowdbench" / file
    text = path.read_text()
    path.write_text(text.replace(old, new, 1) if old else text + new)
    assert changed(before, fingerprints(scene)) == voids


@pytest.mark.parametrize(
    ("file", "voids"),
    [
        ("cox-gmm.json", {p for p in ALL if p.startswith(("cox-gmm ", "cox-plans "))}),
        ("plans.json", {"cox-plans straight"}),
        ("guided-walker.json", {"poisson-gmm guided-walker"}),
        ("ntpp-gmm.safetensors", {"ntpp-gmm anticipate-any"}),
        ("areas.json", ALL),
        ("reference.json.gz", set()),
        ("anchors.json.gz", set()),
    ],
)
def test_a_change_of_a_file_voids_what_reads_it(tmp_path: Path, file: str, voids: set[str]) -> None:
    folder = tmp_path / "plaza-v0"
    shutil.copytree(load_scene("plaza-v0").folder, folder)
    scene = load_scene(folder)
    before = fingerprints(scene)
    with (folder / file).open("ab") as opened:
        opened.write(b" ")
    assert changed(before, fingerprints(scene)) == voids


def test_a_class_of_ones_own_may_read_any_file_of_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "plaza-v0"
    shutil.copytree(load_scene("plaza-v0").folder, folder)
    (tmp_path / "read").mkdir()
    (tmp_path / "read" / "reads_files.py").write_text("class Walker: ...\n")
    monkeypatch.syspath_prepend(tmp_path / "read")
    scene = load_scene(folder)
    before = Resolved.of(scene, "poisson-gmm", "reads_files:Walker").fingerprint("full")
    for file, voids in (("guided-walker.json", True), ("anchors.json.gz", False)):
        with (folder / file).open("ab") as opened:
            opened.write(b" ")
        after = Resolved.of(scene, "poisson-gmm", "reads_files:Walker").fingerprint("full")
        assert (after != before) == voids
        before = after


def test_rules_and_splits_count_and_the_title_does_not() -> None:
    scene = load_scene("plaza-v0")
    pair = Resolved.of(scene, "poisson-gmm", "straight")
    titled = replace(pair, scene=replace(scene, title="Another"))
    slower = replace(pair, scene=replace(scene, dt_s=0.5))
    assert pair.fingerprint("full") == titled.fingerprint("full")
    assert pair.fingerprint("full") != slower.fingerprint("full")
    assert pair.fingerprint("full") != pair.fingerprint("fold0")


def test_the_same_models_have_the_same_fingerprint_under_any_name(tmp_path: Path) -> None:
    scene = load_scene("eth-v0")
    mine = tmp_path / "mine"
    shutil.copytree(scene.folder / "policies" / "bc", mine)
    shipped = Resolved.of(scene, "poisson-gmm", "bc").fingerprint("fold1")
    assert Resolved.of(scene, "poisson-gmm", str(mine)).fingerprint("fold1") == shipped
    assert Resolved.of(scene, "poisson-gmm", "gail").fingerprint("fold1") != shipped


def module_of(file: str) -> str:
    parts = Path(file).relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


RUN = """
import json, sys
from pathlib import Path
ran, opened = set(), set()
def profile(frame, event, argument):
    code = frame.f_code
    if event == "call" and code.co_name[0] != "<":
        ran.add((code.co_filename, code.co_name))
sys.addaudithook(lambda event, args: event == "open" and opened.add(str(args[0])))
from crowdbench.registry import policy, spawn_model
from crowdbench.run.rollout import rollouts, seed_of
from crowdbench.scene import load_scene
scene = load_scene("plaza-v0")
opened.clear()
sys.setprofile(profile)
spawn, walker = (spawn_model(sys.argv[1], scene, "fold1"), policy(sys.argv[2], scene, "fold1"))
rollouts(scene, [spawn], walker, seeds=[seed_of("fold1", 0)])
sys.setprofile(None)
print(json.dumps([sorted(ran), sorted(opened)]))
"""


@pytest.mark.parametrize(
    ("spawn", "policy"),
    [
        pytest.param(*pair, marks=pytest.mark.long if k % 3 == 0 else pytest.mark.nightly)
        for k, pair in enumerate(PAIRS[:-1])
    ],
)
def test_all_that_runs_and_all_that_is_read_is_in_the_fingerprint(spawn: str, policy: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN, spawn, policy], capture_output=True, text=True, check=True
    )
    called, opened = json.loads(done.stdout)
    ran = {(module_of(file), name) for file, name in called if file.startswith(f"{PACKAGE}/")}
    scene = load_scene("plaza-v0")
    pair = Resolved.of(scene, spawn, policy)
    needs = (pair.spawn.dependencies(), pair.policy.dependencies("fold1"))
    modules = code.closure(MAKES_ROLLOUTS, cut=(*MODELS, *PREPARE_RECORDINGS), unused=TRAINING)
    models = (*needs[0].modules, *needs[1].modules)
    modules |= code.closure(models, cut=PREPARE_RECORDINGS, unused=TRAINING)
    if needs[0].recording:  # that of the plaza is generated
        modules |= code.closure(
            ["crowdbench.registry.recordings", "crowdbench.run.plaza_recording"]
        )
    known = {*modules, *code.DECIDE_NOTHING}
    assert {module for module, _ in ran} <= known
    assert "crowdbench.simulation.simulation" in {module for module, _ in ran}
    unused = {name.rpartition(".")[2] for name in TRAINING}
    assert not {(m, f) for m, f in ran if m.startswith("crowdbench.spawn.") and f in unused}
    read = {Path(p).name for p in opened if Path(p).parent == scene.folder}
    assert read <= {"scene.toml", *(file.name for need in needs for file in need.files)}
