"""Typical encounters of a recording, beside the same people simulated from the same moment."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.data.blocks import SPLITS
from crowdbench.data.companions import with_companions
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.files import replacing, unwritable, write_json
from crowdbench.policies import Policy
from crowdbench.registry import ANY_PLACE, policy_source, recording_of, trained_policies
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.replay import Replay
from studies.encounters.drawing import Paths, Shown, animation, still
from studies.encounters.snapshot import Snapshot
from studies.encounters.typical import AROUND_S, Encounter, typical_encounters

POLICY = "anticipate"
"""The policy that walks by default; where the scene does not ship it, `ANY_PLACE`."""


def write_encounters(
    scene: str | Path,
    *,
    policy: str | None = None,
    out: Path = Path("docs/encounters"),
    seed: int = 0,
) -> tuple[list[Path], list[dict[str, Any]]]:
    """Draw the typical encounters of a scene; return the files and the numbers of each encounter.

    The files are `SCENE.png`, `SCENE.gif` and `SCENE.json`. Everyone who is there 4 s before an
    encounter is put there as recorded, and walks by `policy` for 8 s; later arrivals come as
    recorded. A policy with a network per split walks with that of the fold that the encounter is
    held out of.

    Raises:
        RecordingError: the recording has not been imported, or has no encounter.
        SceneError, SettingError, WeightsError: the scene or the policy does not exist, or the seed
            is negative.
        OutputError: `out` cannot be written.
    """
    if seed < 0:
        raise SettingError("seed", got=str(seed), expected="0 or more")
    place = load_scene(scene)
    usual = POLICY if POLICY in trained_policies(place) else ANY_PLACE
    source = policy_source(usual if policy is None else policy, place)
    crowd = with_companions(recording_of(place))
    blocks = reference_of(place).blocks
    found = typical_encounters(place, crowd, blocks)
    if not found:
        raise RecordingError(
            place.id, got="no encounter of any kind", expected="people who meet or stop"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error
    events = Replay(crowd).sample(np.inf, place, np.random.default_rng(0))
    shown, numbers = [], []
    for encounter in found:
        (block,) = np.flatnonzero(
            (blocks.frames[:, 0] <= encounter.frame) & (encounter.frame < blocks.frames[:, 1])
        )
        split = SPLITS[1 + block % (len(SPLITS) - 1)] if source.per_split else "full"
        walker = source.policy(split)
        recorded = recorded_paths(crowd, encounter)
        simulated = walked_paths(place, crowd, events, encounter, walker, seed=seed)
        measured = [encounter.measure(paths, crowd.dt_s) for paths in (recorded, simulated)]
        shown.append(Shown(place, encounter, recorded, simulated, *measured))
        numbers.append(
            {
                "kind": encounter.kind,
                "chosen_from": encounter.chosen_from,
                "measure": encounter.unit,
                "recorded": _rounded(measured[0]),
                "simulated": _rounded(measured[1]),
                "split": split,
            }
        )
    name = source.policy("full" if not source.per_split else SPLITS[1]).name
    return _written(out / place.id, shown, numbers, name), numbers


def _written(
    stem: Path, shown: Sequence[Shown], numbers: list[dict[str, Any]], policy: str
) -> list[Path]:
    files = {".png": still(shown, policy), ".gif": animation(shown, policy)}
    made = []
    for suffix, content in files.items():
        made.append(stem.with_name(stem.name + suffix))
        with replacing(made[-1]) as temporary:
            temporary.write_bytes(content)
    made.append(stem.with_name(f"{stem.name}.json"))
    write_json(made[-1], {"policy": policy, "around_s": AROUND_S, "encounters": numbers})
    return made


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def walked_paths(
    place: Scene,
    crowd: Trajectories,
    events: SpawnEvents,
    encounter: Encounter,
    walker: Policy,
    *,
    seed: int,
) -> Paths:
    """The paths of an encounter's window, simulated from its first frame on.

    `events` are the arrivals of the recording `crowd`.
    """
    snapshot = Snapshot.of(place, crowd, events, encounter.first, encounter.stop)
    horizon_s = (encounter.stop - encounter.first) * crowd.dt_s
    walked = rollout(place, snapshot, walker, seed=seed, horizon_s=horizon_s)
    return _simulated(walked, snapshot, encounter)


def recorded_paths(crowd: Trajectories, encounter: Encounter) -> Paths:
    """The recorded paths of an encounter's window."""
    first, stop = encounter.first, encounter.stop
    paths = {}
    for p in np.flatnonzero((crowd.first < stop) & (crowd.last >= first)).tolist():
        paths[p] = _within(crowd.path(p), int(crowd.first[p]) - first, stop - first)
    return paths


def _simulated(walked: Trajectories, snapshot: Snapshot, encounter: Encounter) -> Paths:
    """The simulated people; `walked` numbers people by their entry, of whom some never enter."""
    known = {
        (float(t), *map(float, start)): person
        for t, start, person in zip(
            snapshot.events.time_s, snapshot.events.start, snapshot.person.tolist(), strict=True
        )
    }
    paths = {}
    for p in range(len(walked)):
        entry = (float(walked.requested_s[p]), *map(float, walked.start[p]))
        paths[known[entry]] = _within(
            walked.path(p), int(walked.first[p]), encounter.stop - encounter.first
        )
    return paths


def _within(path: Float[np.ndarray, "n 2"], begins: int, frames: int) -> Float[np.ndarray, "_ 2"]:
    found = np.full((frames, 2), np.nan)
    here = np.arange(len(path)) + begins
    inside = (here >= 0) & (here < frames)
    found[here[inside]] = path[inside]
    return found
