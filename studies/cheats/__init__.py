"""Cheats: crowds that show what the walking metrics can and cannot tell.

Some of them are as good as the recording (recorded people walked, the recording with noise or
smoothed) and should score about 1. Others do not walk like people (noise, wander, runners) and
should score about 0. All have the recorded arrivals.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crowdbench.data.recordings.noise import noise_of, with_noise
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.policies import Policy, Random, RecordedPaths, SocialForce, Straight
from crowdbench.registry import has_recording, raw_recording_of, recording_of
from crowdbench.report.text.words import to_import
from crowdbench.run.jobs import Job
from crowdbench.run.judge import judge
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout
from crowdbench.run.rollout_jobs import Progress
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.scorecard import Scorecard, read_anchors
from crowdbench.spawn import Replay
from studies.cheats.recordings import shifted, smoothed
from studies.cheats.walkers import MEMORY, WANDER_MPS, Creeper, Runner, Wanderer

SEEDS = 2
"""Number of crowds of each cheat with random numbers."""


class Cheat(NamedTuple):
    """A crowd under the recorded arrivals."""

    name: str
    what: str
    """What it is, for tables."""
    make: Callable[[int], Trajectories]
    """The crowd of a random seed."""
    seeds: int
    """Number of different crowds; 1 if it has no random numbers."""


def cheats_of(scene: Scene) -> list[Cheat]:
    """All cheats on a scene, those that are as good as the recording first.

    Raises:
        RecordingError: the recording has not been imported.
    """
    if not has_recording(scene):
        raise RecordingError(
            scene.id,
            got="no recording",
            expected="the recording, because all cheats have the recorded arrivals",
            hint=f"Run {to_import(scene)}.",
        )
    crowd, tick = recording_of(scene), scene.walking.tick_frames
    raw = raw_recording_of(scene)
    sigma_m = tuple(max(0.01, axis.sigma_m) for axis in noise_of(raw, tick))

    def walked(policy: Policy) -> Callable[[int], Trajectories]:
        return lambda seed: rollout(scene, Replay(crowd), policy, seed=seed)

    def disturbed(of: Callable[[int], Trajectories], times: float) -> Callable[[int], Trajectories]:
        along, across = (times * sigma for sigma in sigma_m)
        return lambda seed: with_noise(of(0), (along, across), tick, _rng(seed))

    straight = cache(walked(Straight()))
    noise_mps = tuple(sigma / scene.dt_s for sigma in sigma_m)
    white = Wanderer("velocity-noise", (noise_mps[0], noise_mps[1]))
    wander = Wanderer("wander", (WANDER_MPS, WANDER_MPS), MEMORY)
    positions = "straight walkers, white noise on positions: {}the recording's"
    return [
        Cheat("recorded-paths", "recorded people walked", walked(RecordedPaths(crowd)), 1),
        Cheat(
            "recording-noise",
            "recording plus its own noise",
            disturbed(lambda _: crowd, 1.0),
            SEEDS,
        ),
        Cheat("recording-smoothed", "recording smoothed", lambda _: smoothed(crowd, tick), 1),
        Cheat(
            "recording-shifted",
            "recorded trips shifted by up to 5 s",
            lambda seed: shifted(crowd, _rng(seed)),
            SEEDS,
        ),
        Cheat("straight", "straight walkers", straight, 1),
        *(
            Cheat(f"position-noise-{name}", positions.format(much), disturbed(straight, k), SEEDS)
            for name, much, k in (
                ("half", "half ", 0.5),
                ("same", "", 1.0),
                ("twice", "twice ", 2.0),
            )
        ),
        Cheat(
            "velocity-noise",
            "straight walkers, white noise on velocities",
            walked(white),
            SEEDS,
        ),
        Cheat("wander", "straight walkers with a random wander", walked(wander), SEEDS),
        Cheat("runner", "straight walkers at 1.7 times the speed", walked(Runner()), 1),
        Cheat(
            "creeper",
            "straight walkers who creep at 0.2 m/s when somebody is near",
            walked(Creeper()),
            1,
        ),
        Cheat("random", "random velocities", walked(Random()), SEEDS),
        Cheat("social-force", "social forces, for comparison", walked(SocialForce()), 1),
    ]


def cheat(
    scene: str | Path | Scene,
    *,
    progress: Progress = lambda done, total: None,
) -> tuple[Scorecard, dict[str, str]]:
    """Score cheats on a scene in protocol `full`; returns the scorecard and what each cheat is.

    Raises:
        RecordingError: the recording has not been imported.
        WeightsError: the scene has no current anchors.
    """
    place = load_scene(scene)
    reference, scale = reference_of(place), read_anchors(place).protocols["full"]
    chosen = cheats_of(place)
    rolled, done, total = {}, 0, sum(each.seeds for each in chosen)
    progress(0, total)
    for each in chosen:
        for seed in range(each.seeds):
            job = Job(place.id, "replay", each.name, "full", 0, seed, Path(), "")
            rolled[job] = RolloutSummary.of_crowd(each.make(seed), reference)
            done += 1
            progress(done, total)
    card = judge(place, reference, rolled, "full", SEEDS, scale)
    return card, {each.name: each.what for each in chosen}


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 18])


__all__ = ["Cheat", "cheat", "cheats_of"]
