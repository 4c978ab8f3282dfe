"""Pages and pictures of `docs`: which there are, what they are made from, and how."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from crowdbench.code import code_hash
from crowdbench.data.blocks import SPLITS
from crowdbench.registry import trained_policies
from crowdbench.run.resolved import MODELS
from crowdbench.scene import list_scenes, load_scene
from crowdbench.scoring.scorecard import WALK_ANCHOR
from crowdbench.spawn.names import PERTURBED
from studies.ceilings import POLICY as CEILING
from studies.copied_arrivals import MODELS as ARRIVING
from studies.copies import HONEST as COPIED_BESIDE
from studies.copies import SCENES as COPIED
from studies.exam import POLICIES as EXAMINED
from studies.figures import BASELINE, BEST, WALKERS
from studies.figures import SPAWN as DRAWN
from studies.joint import ENTRIES as JOINT_BESIDE
from studies.joint import PLANS as JOINTLY
from studies.joint import TIMES
from studies.monte_carlo import PAIRS as MONTE_CARLO
from studies.moving_picture import CROWDS as SHOWN
from studies.paper.study import walker_of
from studies.peers import OURS
from studies.plans import PAIRS as PLAN_PAIRS
from studies.remake.declared import (
    ANCHORS_FILE,
    AREAS,
    COUNTS,
    ENTRY,
    PEERS,
    REAL,
    REFERENCE,
    Pairs,
    facts_of,
    joined,
    rollouts_of,
    scenes_and_entries,
)
from studies.remake.graph import Result
from studies.results import POLICY, SPAWN
from studies.robots import WALKERS as ROBOTS_AMONG
from studies.walks import ARRIVALS, PLAIN

UNUSED = ("crowdbench.evaluation.publish",)
"""Pages are made from evaluations without their reports."""
LARGE = ("eth-v0", "gc-v0", "forum-v0")
"""Scenes of the founding paper, which pages that compare scenes show."""
ORCA = "crowdbench.baselines.orca:ORCA"
FULL, FOLDS = SPLITS[:1], SPLITS[1:]
OVERVIEW = "from pathlib import Path; import studies.paper as p; p.write_overview(Path('docs'))"


def results() -> list[Result]:
    """All results of the repository."""
    return [*scenes_and_entries(), *_of_scenes(), *_comparisons(), *_experiments()]


def _of_scenes() -> Iterator[Result]:
    """Pages and pictures of one scene each."""
    for scene in list_scenes():
        yield _page(
            f"docs/results/{scene}",
            (f"docs/results/{scene}.md", f"docs/results/{scene}/*.png"),
            [("python", "-m", "studies", "results", scene)],
            "studies.results",
            {scene: [(s, p) for s in (*SPAWN, "replay") for p in POLICY]},
        )
    for scene in LARGE:
        walkers = dict.fromkeys(("straight", walker_of(load_scene(scene)), "bc"))
        yield _page(
            f"docs/paper/{scene}",
            (f"docs/paper/{scene}.md", f"docs/paper/{scene}/*"),
            [("python", "-m", "studies", "paper", scene)],
            "studies.paper",
            {scene: [(s, p) for s in ("ntpp-gmm", "replay") for p in walkers]},
            splits=FULL,
            trains=True,
        )
    for scene in REAL:
        ceilings = _page(
            f"ceilings/{scene}",
            (f"scenes/{scene}/ceilings.json",),
            [("python", "-m", "studies", "ceilings", scene)],
            "studies.ceilings",
            {scene: [("replay", CEILING), (PERTURBED, CEILING), WALK_ANCHOR]},
            splits=FOLDS,
        )
        yield replace(ceilings, files=(*ceilings.files, ENTRY.format(CEILING)))
        yield _page(
            f"docs/encounters/{scene}",
            (f"docs/encounters/{scene}.*",),
            [("python", "-m", "studies", "encounters", scene)],
            "studies.encounters",
            {scene: [("replay", _best(scene))]},
            splits=FOLDS,
        )
    for name, scene in (("rush_hour", "gc-v0"), ("closed_door", "forum-v0")):
        toml = f"docs/steering/{name}.toml"
        yield _page(
            f"docs/steering/{name}",
            (f"docs/steering/{name}-*.png",),
            [("crowdbench", "spawn", "steer", scene, toml, "--out", "docs/steering")],
            "crowdbench.report.steering.pictures",
            {scene: [("ntpp-gmm", "straight"), (f"ntpp-gmm+{toml}", "straight")]},
            splits=FULL,
        )

    yield _page(
        "docs/steering/areas",
        ("docs/steering/gc-areas.png",),
        [("crowdbench", "spawn", "areas", "gc-v0", "--out", "docs/steering/gc-areas.png")],
        "crowdbench.report.steering.pictures",
        {"gc-v0": [("poisson-gmm", "straight")]},
        splits=FULL,
    )


def _comparisons() -> Iterator[Result]:
    """Pages and pictures that compare scenes."""
    yield Result(
        "docs/paper",
        ("docs/paper.md",),
        (("python", "-c", OVERVIEW),),
        files=tuple(f"docs/paper/{scene}/verdicts.json" for scene in sorted(LARGE)),
        facts={"code": joined([code_hash("studies.paper.page")])},
    )
    yield _page(
        "docs/walks",
        ("docs/walks.md", "docs/walks/*.png"),
        [("python", "-m", "studies", "walks", *LARGE, "--policy", ORCA)],
        "studies.walks",
        {
            scene: [(s, p) for s in ("replay", ARRIVALS) for p in (*PLAIN, ORCA, *_trained(scene))]
            for scene in LARGE
        },
    )
    yield _page(
        "docs/figures",
        ("docs/figures/*/*", "docs/figures/sheet.*"),
        [("python", "-m", "studies", "figures", *LARGE)],
        "studies.figures",
        {
            scene: [
                *(("replay", policy) for policy in (*WALKERS, *_trained(scene))),
                *((spawn, _best(scene)) for spawn in (DRAWN, BASELINE)),
            ]
            for scene in LARGE
        },
        splits=FULL,
    )
    yield _page(
        "docs/crowds",
        ("docs/crowds.webp",),
        [("python", "-m", "studies", "moving-picture")],
        "studies.moving_picture",
        {"gc-v0": SHOWN},
        splits=FULL,
    )
    yield Result(
        "docs/peers",
        ("docs/peers.md", *map(str, Path("docs/peers").glob("exam.png"))),
        (("python", "-m", "studies", "peers"),),
        files=(
            *(str(path) for pattern in PEERS for path in sorted(Path().glob(pattern))),
            *(ENTRY.format(name) for name in OURS),
            *(f"examples/peers/{name}" for name in (COUNTS, "calibrated.json")),
        ),
        facts={"code": joined([code_hash("studies.peers", cut=MODELS)])},
    )
    yield _page(
        "docs/rollouts",
        ("docs/rollouts.md",),
        [("python", "-m", "studies", "monte-carlo")],
        "studies.monte_carlo",
        dict.fromkeys(REAL, MONTE_CARLO),
        splits=FOLDS,
        stdout="docs/rollouts.md",
    )
    yield _page(
        "docs/bodies",
        ("docs/bodies.md",),
        [("python", "-m", "studies", "bodies")],
        "studies.bodies",
        {scene: [("replay", "recorded-paths")] for scene in (*REAL, "plaza-v0")},
        splits=FULL,
        stdout="docs/bodies.md",
    )
    yield _page(
        "docs/exam",
        ("docs/exam.md",),
        [("python", "-m", "studies", "exam")],
        "studies.exam",
        {"eth-v0": [("replay", policy) for policy in EXAMINED]},
        splits=FULL,
        stdout="docs/exam.md",
    )
    yield _page(
        "docs/trust",
        ("docs/trust.md",),
        [("python", "-m", "studies", "copies")],
        "studies.copies",
        {
            scene: [(s, p) for s in ("replay", "perturbed-replay") for p in COPIED_BESIDE]
            + [(model, "straight") for model in ARRIVING]
            for scene in COPIED
        },
        splits=FULL,
        stdout="docs/trust.md",
    )
    robots = _page(
        "docs/robot-table",
        ("docs/robot-table.md", "docs/robots/*"),
        [("python", "-m", "studies", "robots")],
        "studies.robots",
        {"eth-v0": [("ntpp-gmm", "straight"), *(("replay", p) for p in ROBOTS_AMONG)]},
        splits=FULL,
        stdout="docs/robot-table.md",
    )
    yield replace(robots, files=(*robots.files, "scenes/eth-v0/robots/ppo.onnx"))
    yield _page(
        "docs/cheats",
        ("docs/cheats.md",),
        [("python", "-m", "studies", "cheats", scene) for scene in LARGE],
        "studies.cheats",
        {scene: [("replay", policy) for policy in ("straight", "social-force")] for scene in LARGE},
        by_hand=True,
    )


def _experiments() -> Iterator[Result]:
    """Pages of what is trained or measured for them alone."""
    scenes = (*REAL, "plaza-v0")
    yield _page(
        "docs/plans",
        ("docs/plans.md",),
        [("python", "-m", "studies", "plans", *scenes)],
        "studies.plans",
        {s: [p for p in PLAN_PAIRS if p[1] in ("straight", *_trained(s))] for s in scenes},
        splits=FULL,
        trains=True,
        stdout="docs/plans.md",
    )
    joint = _page(
        "docs/joint",
        ("docs/joint.md",),
        [("python", "-m", "studies", "joint")],
        "studies.joint",
        {s: [(model, "straight") for model in (*TIMES, *JOINTLY)] for s in scenes},
        stdout="docs/joint.md",
    )
    yield replace(joint, files=(*joint.files, *map(ENTRY.format, JOINT_BESIDE)))
    yield _page(
        "docs/ablation",
        ("docs/ablation.md",),
        [("python", "-m", "studies", "ablation", "eth-v0")],
        "studies.ablation",
        {"eth-v0": [("replay", "straight")]},
        trains=True,
        stdout="docs/ablation.md",
    )
    yield _page(
        "docs/across",
        ("docs/across.md",),
        [("python", "-m", "studies", "across")],
        "studies.across",
        {scene: [("replay", "social-force"), ("replay", BEST)] for scene in REAL},
        splits=FOLDS,
        trains=True,
        stdout="docs/across.md",
    )
    yield _page(
        "docs/growth",
        ("docs/growth.md",),
        [("python", "-m", "studies", "growth", "--out", "docs/growth.md")],
        "studies.growth_page",
        {},
        trains=True,
    )


def _page(
    name: str,
    outputs: tuple[str, ...],
    commands: Sequence[tuple[str, ...]],
    root: str,
    shown: Mapping[str, Pairs],
    *,
    splits: Sequence[str] = SPLITS,
    trains: bool = False,
    stdout: str = "",
    by_hand: bool = False,
) -> Result:
    """A page: its commands, the module that writes it, and the rollouts that it shows by scene.

    With `trains` it may use the code of all models, else only that of those rollouts.
    """
    files: dict[str, None] = {}
    facts: dict[str, str] = {}
    codes = [code_hash(root, cut=() if trains else MODELS, unused=UNUSED)]
    for scene, pairs in shown.items():
        of_models, code = rollouts_of(scene, pairs, splits)
        names = (AREAS, REFERENCE, ANCHORS_FILE)
        files |= of_models | dict.fromkeys(file.format(scene) for file in names)
        facts |= facts_of(scene)
        codes.append(code)
    facts["code"] = joined(codes)
    return Result(name, outputs, tuple(commands), stdout, by_hand, tuple(files), facts)


def _trained(scene: str) -> list[str]:
    return trained_policies(load_scene(scene))


def _best(scene: str) -> str:
    return BEST if BEST in _trained(scene) else WALKERS[-1]
