"""Scenes and leaderboard: which results there are, what they are made from, and how.

The names of generated files stand at the top, so that another format is a change of one line.
"""

import tomllib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import msgspec

from crowdbench.code import code_hash
from crowdbench.data.blocks import SPLITS
from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.files import sha256
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.submission.models import shipped_class
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.leaderboard.verification.copying import INDEPENDENT
from crowdbench.leaderboard.verification.entry import read_entry
from crowdbench.policies.guided import FILE as WALKER
from crowdbench.registry import FITTED, GENERATED, PLANNED, WEIGHTS
from crowdbench.run.jobs import splits_of
from crowdbench.run.resolved import MODELS, Resolved, code_of_rollouts
from crowdbench.scene import list_scenes, load_scene
from crowdbench.scene_building.fit import NEURAL
from crowdbench.scoring.scorecard import BASELINES
from crowdbench.spawn.joint import trunks
from crowdbench.spawn.joint.model import NAME as JOINT
from studies.clips import FILE as CLIPS
from studies.clips import pair_of, split_of
from studies.copy_limits import HONEST
from studies.remake.graph import Result

AREAS, PLANS = "scenes/{}/areas.json", "scenes/{}/plans.json"
REFERENCE, ANCHORS_FILE = "scenes/{}/reference.json.gz", "scenes/{}/anchors.json.gz"
FIT = "scenes/{}/{}"
TRUNKS = f"scenes/{trunks.FILE}"
ENTRY = "leaderboard/entries/{}.json.gz"
PEERS = ("leaderboard/entries/jupedsim-*.json.gz", "leaderboard/entries/pysocialforce-*.json.gz")
COUNTS = "counts.json"
LIMITS = "crowdbench/leaderboard/verification/copy_limits.json"
PAGES = ("leaderboard/README.md", "leaderboard/index.html")

REAL = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
"""Scenes with recordings of people."""
Pairs = Sequence[tuple[str, str]]


def scenes_and_entries() -> list[Result]:
    """What scenes ship, the entries, and the pages of the leaderboard."""
    submissions = sorted(Path("leaderboard/submissions").glob("*/submission.toml"))
    entries = [_entry(path.parent) for path in submissions]
    clips = [_clips(path.parent) for path in submissions]
    of_scenes = [result for scene in list_scenes() for result in _of_scene(scene)]
    peers = _peers()
    tables = [path for e in (*entries, peers) for path in e.outputs if path.endswith(".json.gz")]
    tables = [str(path) for pattern in tables for path in sorted(Path().glob(pattern))]
    board = Result(
        "leaderboard",
        PAGES,
        (("python", "-m", "studies", "leaderboard"),),
        files=(*tables, LIMITS),
        facts={"code": joined([code_hash("studies.site", cut=MODELS)])},
    )
    walkers = [_walker(scene) for scene in REAL]
    return [_trunks(), *of_scenes, *walkers, _limits(), *entries, peers, *clips, board]


def _trunks() -> Result:
    """The networks of `joint-gmm` that have learned from several scenes."""
    facts: dict[str, str] = {}
    for place in REAL:
        facts |= facts_of(place)
    codes = [code_hash("crowdbench.baselines.joint"), *map(_reading, REAL)]
    return Result(
        "trunks",
        (TRUNKS,),
        (("python", "-m", "crowdbench.baselines.joint"),),
        files=tuple(AREAS.format(place) for place in REAL),
        facts=facts | {"code": joined(codes)},
    )


def _walker(scene: str) -> Result:
    """The parameters of the guided walker, of which some are searched in the other scenes."""
    files: dict[str, None] = {}
    facts: dict[str, str] = {}
    walker = "crowdbench.baselines.guided", "crowdbench.policies.guided"
    codes = [code_hash(module, cut={*MODELS} - {module}) for module in walker]
    for place in REAL:
        of_models, code = rollouts_of(place, [("replay", "straight")], SPLITS[:1])
        files |= of_models | {AREAS.format(place): None, REFERENCE.format(place): None}
        facts |= facts_of(place)
        codes.append(code)
    return Result(
        f"walker/{scene}",
        (f"scenes/{scene}/{WALKER}",),
        (("python", "-m", "crowdbench.baselines.guided", "--scenes", scene),),
        files=tuple(files),
        facts=facts | {"code": joined(codes)},
    )


def _limits() -> Result:
    """What the leaderboard flags copied trips and arrivals by."""
    files: dict[str, None] = {}
    facts: dict[str, str] = {}
    codes = [code_hash("studies.copy_limits", cut=MODELS)]
    for scene in list_scenes():
        pairs = [
            *(("replay", policy) for policy in HONEST),
            *((s, "straight") for s in INDEPENDENT),
        ]
        of_models, code = rollouts_of(scene, pairs, SPLITS[:1])
        files |= of_models
        facts |= facts_of(scene)
        codes.append(code)
    facts["code"] = joined(codes)
    return Result(
        "limits",
        (LIMITS,),
        (("python", "-m", "studies", "copy-limits"),),
        files=tuple(files),
        facts=facts,
    )


def _peers() -> Result:
    """The entries of other simulators' models, in an environment of their own."""
    sources = sorted(Path("examples/peers").glob("*.*"))
    files = dict.fromkeys(str(path) for path in sources if path.name not in ("README.md", COUNTS))
    files |= dict.fromkeys([LIMITS])
    facts: dict[str, str] = {}
    codes = [code_hash("crowdbench.leaderboard.verification.make_entry", cut=MODELS)]
    for scene in REAL:
        of_models, code = rollouts_of(scene, [("replay", "straight")], SPLITS[:1])
        names = (AREAS, REFERENCE, ANCHORS_FILE)
        files |= of_models | dict.fromkeys(name.format(scene) for name in names)
        facts |= facts_of(scene)
        codes.append(code)
    return Result(
        "peers",
        (*PEERS, f"examples/peers/{COUNTS}", "docs/peers/crossing.png"),
        (
            ("make", ".venv-peers/peers.stamp"),
            *(("peers", command) for command in ("exam", "entries", "crossing")),
        ),
        files=tuple(files),
        facts=facts | {"code": joined(codes)},
    )


def joined(codes: Sequence[str]) -> str:
    """One hash of several."""
    return sha256("".join(codes).encode())[:8]


def _of_scene(scene: str) -> Iterator[Result]:
    """Areas and reference, fits, plans and anchors of a scene."""
    areas, plans = AREAS.format(scene), PLANS.format(scene)
    facts = facts_of(scene)
    fit = ("crowdbench", "scene", "fit", scene, "--models")
    shared = _reading(scene) + _alone("crowdbench.scene_building.fit")
    code = code_hash("crowdbench.spawn.areas", "crowdbench.scoring.reference")
    yield Result(
        f"areas/{scene}",
        (areas, REFERENCE.format(scene)),
        (fit,),
        facts=facts | {"code": joined([code, shared])},
    )
    weights = {name: FIT.format(scene, file) for file, name in WEIGHTS.items()}
    fitted = {name: file for name, file in weights.items() if Path(file).exists()}
    for name, file in fitted.items():
        trains = (NEURAL[name],) if name in NEURAL else ()
        code = code_hash(FITTED[name].__module__, *trains)
        yield Result(
            f"fits/{scene}/{name}",
            (file,),
            ((*fit, name),),
            files=(areas, TRUNKS) if name == JOINT else (areas,),
            facts=facts | {"code": joined([code, shared])},
        )
    times = [fitted[name] for name in dict.fromkeys(PLANNED.values()) if name in fitted]
    code = code_hash("crowdbench.scene_building.plan_calibration", "crowdbench.spawn.plans.fitting")
    yield Result(
        f"plans/{scene}",
        (plans,),
        (fit,),
        files=(areas, *times),
        facts=facts | {"code": joined([code, shared])},
    )
    files, code = rollouts_of(scene, BASELINES, SPLITS)
    files |= dict.fromkeys([REFERENCE.format(scene), fitted["poisson-gmm"]])
    code += code_hash("crowdbench.run.judge", cut=MODELS)
    code += _alone("crowdbench.scene_building.anchors")
    yield Result(
        f"anchors/{scene}",
        (ANCHORS_FILE.format(scene),),
        (("crowdbench", "scene", "anchors", scene),),
        files=tuple(files),
        facts=facts | {"code": joined([code])},
    )


def _entry(folder: Path) -> Result:
    """The entry of a submission."""
    declared = tomllib.loads((folder / "submission.toml").read_text())
    path = ENTRY.format(folder.name)
    files = dict.fromkeys([*(str(f) for f in sorted(folder.rglob("*")) if f.is_file()), LIMITS])
    facts: dict[str, str] = {}
    codes = [code_hash("crowdbench.leaderboard.verification.make_entry", cut=MODELS)]
    splits = splits_of(declared["training"]["protocol"])
    for scene in declared["scenes"]:
        own = folder / scene
        spawn = declared.get("shipped_spawn") or str(own / "spawn")
        policy = shipped_class(declared.get("shipped_policy", "")) or str(own / "policy")
        track = declared["track"]
        policy = "straight" if track == "spawn" else policy
        pairs = [("replay", policy)] * (track != "spawn") + [(spawn, policy)] * (track != "walk")
        of_models, code = rollouts_of(scene, pairs, splits)
        names = (AREAS, REFERENCE, ANCHORS_FILE)
        files |= of_models | dict.fromkeys(name.format(scene) for name in names)
        facts |= facts_of(scene)
        codes.append(code)
    return Result(
        f"entries/{folder.name}",
        (path,),
        (("python", "-m", "studies.remake.entry", folder.name),),
        files=tuple(files),
        facts=facts | {"code": joined(codes)},
        headline=lambda: _score(path),
    )


def _clips(folder: Path) -> Result:
    """The clips of an entry."""
    submission = read_submission(folder)
    files = dict.fromkeys(str(f) for f in sorted(folder.rglob("*")) if f.is_file())
    facts: dict[str, str] = {}
    codes = [code_hash("studies.clips", cut=MODELS)]
    for scene in submission.declared.scenes:
        if pair := pair_of(submission, scene):
            of_models, code = rollouts_of(scene, [pair], [split_of(submission)])
            files |= of_models | {AREAS.format(scene): None}
            facts |= facts_of(scene)
            codes.append(code)
    return Result(
        f"clips/{folder.name}",
        (f"leaderboard/{CLIPS.format(folder.name)}",),
        (("python", "-m", "studies", "clips", folder.name),),
        files=tuple(files),
        facts=facts | {"code": joined(codes)},
    )


def _score(path: str) -> dict[str, float]:
    entry = read_entry(Path(path))
    found = scores(entry)
    views = {"overall": View()} | {name: View(scene=name) for name in entry.scenes}
    return {name: round(found[view].value, 4) for name, view in views.items() if view in found}


def rollouts_of(scene: str, pairs: Pairs, splits: Sequence[str]) -> tuple[dict[str, None], str]:
    """The files that the rollouts of pairs depend on, and the hash of their code."""
    place = load_scene(scene)
    files: dict[str, None] = {}
    modules: set[str] = set()
    reads = ""
    for spawn, policy in pairs:
        pair = Resolved.of(place, spawn, policy)
        for split in splits if pair.policy.networks is not None else splits[:1]:
            for needs in (pair.spawn.dependencies(), pair.policy.dependencies(split)):
                files |= dict.fromkeys(_relative(file) for file in needs.files)
                modules |= set(needs.modules)
                reads = _reading(scene) if needs.recording else reads
    return files, code_of_rollouts(sorted(modules)) + reads


def _relative(file: Path) -> str:
    return str(file.resolve().relative_to(Path().resolve()))


@cache
def facts_of(scene: str) -> dict[str, str]:
    """Hashes of a scene's settings, and of the recording as published."""
    place = load_scene(scene)
    more = [place.walking, place.gate, place.protocol.scored, place.clustering]
    name = place.recording.name
    published = "generated" if name in GENERATED else str(SOURCES[name].sha256)
    encoded = place.rules + msgspec.json.encode(more, order="deterministic")
    settings = sha256(encoded)[:8]
    return {f"settings of {scene}": settings, f"recording {name}": published[:8]}


@cache
def _reading(scene: str) -> str:
    """Hash of the code that reads and prepares a scene's recording."""
    generated = GENERATED.get(load_scene(scene).recording.name, "").partition(":")[0]
    return code_hash("crowdbench.registry.recordings", *([generated] if generated else []))


def _alone(module: str) -> str:
    """Hash of the code of a module without what it imports, which is hashed with its results."""
    return code_hash(module, cut=("crowdbench",))
