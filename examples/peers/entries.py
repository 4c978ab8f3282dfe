"""Entries of the leaderboard with the status `external`: models of other simulators, run by us.

They are judged as all entries of the track *walk*: under the recorded arrivals, held out.
Calibrated parameters of a fold were chosen on its training blocks. `python -m studies peers` writes
a page about them.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

from crowdbench import __version__
from crowdbench.code import code_hash
from crowdbench.data.blocks import SPLITS
from crowdbench.data.storage import read_own
from crowdbench.errors import WeightsError
from crowdbench.exam import verdicts
from crowdbench.files import read_struct, sha256, write_json, write_text
from crowdbench.leaderboard.submission.schema import Declared, Trained
from crowdbench.leaderboard.submission.submission import slug
from crowdbench.leaderboard.verification.copying import copies_in
from crowdbench.leaderboard.verification.entry import (
    SCHEMA,
    SCORER,
    Entry,
    ExamEntry,
    Flag,
    SceneEntry,
    entry_path,
)
from crowdbench.leaderboard.verification.scene_entry import SceneRollouts, scene_entry
from crowdbench.run.jobs import Job
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference

from .calibrate import HORIZON_S, TRIALS
from .calibrated import is_calibrated, parameters_of
from .models import MODELS, Peer
from .walk import OUT, Column, Walk, counts_of, key_of, make, wanted

ENTRIES = Path("leaderboard/entries")
EXAM_SCENE = "eth-v0"
"""The scene whose time step is used in the exam."""
COUNTS = Path(__file__).parent / "counts.json"
"""What could not be done as asked, by entry and scene."""
_SOURCES: Mapping[Column, Sequence[str]] = {
    "published": ("adapter.py", "models.py"),
    "calibrated": ("adapter.py", "calibrated.json", "models.py"),
}
_TITLES = {
    "collision-free-speed-v2": "collision-free speed V2",
    "collision-free-speed-v3": "collision-free speed V3",
    "anticipation-velocity": "anticipation velocity",
    "social-force-jupedsim": "social force",
    "generalized-centrifugal-force": "generalized centrifugal force",
    "warp-driver": "WarpDriver",
    "pysocialforce": "",
}


def write_entries(
    scenes: Sequence[str], models: Sequence[str], columns: Sequence[Column], *, workers: int
) -> list[str]:
    """Walk and judge models; write their entries and counts. Returns the ids of the entries.

    An entry has just these scenes, and replaces an earlier one.
    Verdicts of the exam are in an entry if `examine` has made them.
    """
    everything = [walk for column in columns for walk in wanted(scenes, models, column)]
    kept = [w for w in everything if _is_possible(w.model, w.scene, w.column)]
    for model, scene in sorted({(w.model, w.scene) for w in everything if w not in kept}):
        print(f"{model} is not calibrated on {scene}, and left out there", flush=True)
    everything = kept
    make(everything, workers)
    written = []
    for model in models:
        for column in columns:
            walks = [w for w in everything if (w.model, w.column) == (model, column)]
            if not walks:
                continue
            entry = entry_of(MODELS[model], column, walks)
            write_json(entry_path(ENTRIES, entry.id), entry)
            _count(entry.id, walks)
            written.append(entry.id)
            print(f"written: {entry.id}", flush=True)
    return written


def _is_possible(model: str, scene: str, column: Column) -> bool:
    return column == "published" or is_calibrated(model, scene)


def name_of(model: str, column: Column) -> str:
    """The name of an entry, with the version of the library."""
    library = "PySocialForce" if model == "pysocialforce" else "JuPedSim"
    made = f"{library} {version(library.lower())} {_TITLES[model]}".strip()
    return f"{made}, calibrated" if column == "calibrated" else made


def entry_of(kind: type[Peer], column: Column, walks: Sequence[Walk]) -> Entry:
    """The entry of a model from its rollouts."""
    scenes: dict[str, SceneEntry] = {}
    flags: list[Flag] = []
    for scene in dict.fromkeys(walk.scene for walk in walks):
        of_scene, found = scene_entry(_rolled(scene, [w for w in walks if w.scene == scene]))
        scenes[scene] = of_scene
        flags += found
    name, here = name_of(kind.name, column), Path(__file__).parent
    return Entry(
        schema=SCHEMA,
        id=slug(name),
        status="external",
        declared=_declared(name, kind, column, tuple(scenes)),
        scorer=SCORER,
        crowdbench=__version__,
        artefacts={
            f"examples/peers/{n}": sha256((here / n).read_bytes())
            for n in sorted({kind.adapted_in, *_SOURCES[column]})
        },
        scenes=scenes,
        flags=flags,
        exam=_verdicts(kind.name, column),
        history=[],
    )


def _rolled(scene: str, walks: Sequence[Walk]) -> SceneRollouts:
    place = load_scene(scene)
    reference = read_reference(place)
    pair = ("replay", walks[0].model)
    rolled = {}
    for walk in walks:
        crowd = read_own(walk.path)
        job = Job(scene, *pair, walk.split, 0, walk.seed, walk.path, "")
        rolled[job] = RolloutSummary.of_crowd(crowd, reference, copies_in(job, crowd))
    seeds = max(2, sum(walk.split == walks[0].split for walk in walks))
    return SceneRollouts(place, reference, "heldout", None, pair, [*rolled], seeds, rolled)


def examine(models: Sequence[str], columns: Sequence[Column], workers: int) -> None:
    """Put models through the exam; its verdicts are kept."""
    tasks = [
        (model, column)
        for column in columns
        for model in models
        if _is_possible(model, EXAM_SCENE, column)
    ]
    missing = [task for task in tasks if not _exam_file(*task).exists()]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(_examined, *task): task for task in missing}
        for done, future in enumerate(as_completed(jobs), 1):
            entry = future.result()
            told = f"{len(entry.passed)} of {len(entry.passed) + len(entry.failed)} tests passed"
            print(f"{done} of {len(missing)}: {' '.join(jobs[future])}: {told}", flush=True)


def _verdicts(model: str, column: Column) -> ExamEntry | None:
    if not _is_possible(model, EXAM_SCENE, column):
        return None
    file = _exam_file(model, column)
    return read_struct(file, ExamEntry, WeightsError, "") if file.exists() else None


def _exam_file(model: str, column: Column) -> Path:
    """Where the verdicts of the exam are kept, by what they depend on."""
    parameters = json.dumps(dict(_exam_parameters(model, column)))
    of = [parameters, key_of(load_scene(EXAM_SCENE), MODELS[model]), code_hash("crowdbench.exam")]
    return OUT / "exam" / f"{model}-{sha256(' '.join(of).encode())[:16]}.json"


def _exam_parameters(model: str, column: Column) -> Mapping[str, float]:
    """Calibrated parameters are those of the scene whose time step is used, and the first fold."""
    return {} if column == "published" else parameters_of(model, EXAM_SCENE, SPLITS[1])


def _examined(model: str, column: Column) -> ExamEntry:
    walker = MODELS[model](_exam_parameters(model, column))
    found = verdicts(walker, EXAM_SCENE)
    entry = ExamEntry(
        scene=EXAM_SCENE,
        body_radius_m=found.body_radius_m,
        passed=[of.id for of in found.tests if of.passed],
        failed=[of.id for of in found.tests if not of.passed],
    )
    write_json(_exam_file(model, column), entry)
    return entry


def _declared(name: str, kind: type[Peer], column: Column, scenes: Sequence[str]) -> Declared:
    calibrated = column == "calibrated"
    link = "https://github.com/yuxiang-gao/PySocialForce"
    if kind.name != "pysocialforce":
        link = "https://www.jupedsim.org"
    part = [f"on {scene} of its first {s:g} s" for scene, s in HORIZON_S.items() if scene in scenes]
    data = (
        f"The training blocks of each fold{''.join(f', {of}' for of in part)}: "
        f"{TRIALS} trials of an optimiser."
        if calibrated
        else "None: the default parameters of the library."
    )
    return Declared(
        schema=1,
        name=name,
        authors=["run by crowdbench"],
        contact="an issue of this repository",
        link=link,
        licence="MIT" if kind.name == "pysocialforce" else "LGPL-3.0-or-later",
        track="walk",
        kind="privileged",
        scenes=[*scenes],
        training=Trained(
            data=data,
            protocol="heldout" if calibrated else "none",
            parameters=len(kind.searched) if calibrated else 0,
        ),
    )


def _count(entry_id: str, walks: Sequence[Walk]) -> None:
    known = json.loads(COUNTS.read_text()) if COUNTS.exists() else {}
    of_scenes: dict[str, dict[str, float]] = {}
    for scene in dict.fromkeys(walk.scene for walk in walks):
        each = [counts_of(walk) for walk in walks if walk.scene == scene]
        of_scenes[scene] = {n: round(sum(c[n] for c in each) / len(each), 1) for n in each[0]}
    known[entry_id] = of_scenes
    write_text(COUNTS, json.dumps(dict(sorted(known.items())), indent=1) + "\n")
