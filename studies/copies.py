"""Copies: policies that know the recorded paths by heart and disguise them, beside honest ones."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.path_copies import (
    LAG_S,
    SHORTEST_S,
    SIMILAR,
    PathCopies,
)
from crowdbench.policies import Policy, SocialForce, StateView
from crowdbench.registry import policy as find_policy
from crowdbench.registry import recording_of, spawn_model
from crowdbench.report.text.words import interval, share
from crowdbench.run.jobs import DRAWS, Job
from crowdbench.run.judge import judge
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import read_anchors
from crowdbench.spawn import Replay
from crowdbench.spawn.perturbed_replay import GOAL_M, ROOM_M, SPEED, START_M, TIME_S
from studies import copied_arrivals
from studies.markdown import flowed, table

Path2 = Float[np.ndarray, "n 2"]
Alter = Callable[[Path2, int], Path2]
"""A disguise: another path for the recorded one of a person."""
HONEST = ("straight", "social-force", "anticipate", "gail", "ppo", "bc")
SCENES = ("eth-v0", "forum-v0")
ARRIVALS = ("replay", "perturbed-replay:copies")
RECOGNISED_M = 0.02
"""Tolerance of start and preferred speed by which a copy recognises a recorded person."""


class Copy(SocialForce):
    """Walks an altered copy of the path of whom it recognises; others walk by social forces.

    It recognises a person by its exact start and speed; with `nearest` by the most similar start
    and goal, and turns and stretches that path to fit.
    """

    deterministic: ClassVar[bool] = True
    many_worlds: ClassVar[bool] = False
    sees: ClassVar[Literal["state"]] = "state"

    def __init__(
        self, name: str, recording: Trajectories, scene: Scene, alter: Alter, *,
        known: float = 1.0, nearest: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.name, self._nearest = name, nearest
        events = Replay(recording).sample(scene.horizon_s, scene, np.random.default_rng(0))
        self._start, self._goal = events.start, events.goal
        self._key = np.column_stack([events.start, events.speed])
        paths = [recording.path(k).astype(np.float64) for k in range(len(recording))]
        self._paths = [alter(path, k) for k, path in enumerate(paths)]
        forgotten = np.random.default_rng(0).random(len(paths)) >= known
        self._key[forgotten] = np.inf

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode, in which nobody is recognised yet."""
        super().reset(scene, rng)
        self._whose: dict[int, tuple[Path2 | None, int]] = {}

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) along the altered paths, else of social forces."""
        actions = super().act(seen).astype(np.float64)
        step = self._scene.dt_s * self._scene.motion.max_speed_mps
        for i, person in enumerate(seen.person.tolist()):
            frame = int(seen.frame[i])
            if person not in self._whose:
                self._whose[person] = self._recognised(seen, i), frame
            path, since = self._whose[person]
            if path is not None and frame - since + 1 < len(path):
                actions[i] = (path[frame - since + 1] - seen.position[i]) / step
        return actions.clip(-1, 1).astype(np.float32)

    def _recognised(self, seen: StateView, i: int) -> Path2 | None:
        if not self._nearest:
            apart = np.abs(self._key - [*seen.position[i], seen.speed[i]]).max(axis=1)
            k = int(apart.argmin())
            return self._paths[k] if apart[k] < RECOGNISED_M else None
        apart = np.linalg.norm(self._start - seen.position[i], axis=1)
        apart += np.linalg.norm(self._goal - seen.goal[i], axis=1)
        return fitted(self._paths[int(apart.argmin())], seen.position[i], seen.goal[i])


def fitted(path: Path2, start: Path2, goal: Path2) -> Path2:
    """A path, turned and stretched so that it leads from a start to a goal."""
    z = (path - path[0]) @ [1, 1j]
    way = complex(*(np.asarray(goal, dtype=np.float64) - start))
    if abs(z[-1]) > 1 and 0.5 < abs(way / z[-1]) < 2:
        z = z * way / z[-1]
    return np.asarray(np.stack([z.real, z.imag], axis=1) + start)


def bowed(by_m: float, *, alternating: bool = False) -> Alter:
    """Bowed sideways by a length in the middle; alternating to both sides."""

    def alter(path: Path2, k: int) -> Path2:
        across = _across(path) * by_m * ((-1) ** k if alternating else 1)
        return path + np.sin(np.pi * np.linspace(0, 1, len(path)))[:, None] * across

    return alter


def mirrored(path: Path2, k: int) -> Path2:
    """Mirrored at the line from start to end."""
    across = _across(path)
    return path - 2 * ((path - path[0]) @ across)[:, None] * across


def warped(by_s: float, dt_s: float) -> Alter:
    """Earlier and later along the path by a time."""

    def alter(path: Path2, k: int) -> Path2:
        frame = np.arange(len(path))
        last = max(len(path) - 1, 1)
        when = frame + by_s / dt_s * np.sin(2 * np.pi * frame / last) * min(1, last * dt_s / 6)
        return np.stack([np.interp(when, frame, path[:, d]) for d in (0, 1)], axis=1)

    return alter


def _across(path: Path2) -> Float[np.ndarray, " 2"]:
    way = path[-1] - path[0]
    length = float(np.linalg.norm(way))
    along = way / length if length > 0.5 else np.array([1.0, 0.0])
    return np.array([-along[1], along[0]])


def copies_of(scene: Scene) -> list[Copy]:
    """The copies: exact, bowed, mirrored, warped, of some trips only, and nearest trips fitted."""
    recording = recording_of(scene)

    def copy(name: str, alter: Alter, *, known: float = 1.0, nearest: bool = False) -> Copy:
        return Copy(name, recording, scene, alter, known=known, nearest=nearest)

    return [
        copy("exact", lambda path, k: path),
        *(copy(f"bowed by {by:g} m", bowed(by)) for by in (0.12, 0.2, 0.3, 0.5)),
        copy("bowed by 0.15 m, alternating", bowed(0.15, alternating=True)),
        copy("mirrored", mirrored),
        *(copy(f"warped by {by:g} s", warped(by, scene.dt_s)) for by in (0.3, 0.5)),
        copy("30 % of trips, bowed by 0.12 m", bowed(0.12), known=0.3),
        copy("nearest trip, fitted", lambda path, k: path, nearest=True),
        copy("nearest trip, fitted and bowed by 0.12 m", bowed(0.12), nearest=True),
    ]


TITLE = """# Whoever copies does not walk

All recordings are public. A network can know the recorded paths by heart, recognise a person by
the exact start and speed, and walk a copy of its path, bowed sideways by some centimetres. Under
the recorded arrivals it scores like the recording itself. Two things tell it from a policy that
walks by what is there:

**People who never came.** The spawn model `perturbed-replay` changes the recorded arrivals at
random: each group enters up to {time:g} s earlier or later; its starts are moved by {start:g} m,
its goals by {goal:g} m and its speeds by {speed:g} % (standard deviations), companions alike, and
nobody nearer than {room:g} m to a wall. Nobody knows a path of these people by heart.
`perturbed-replay:KEY` has other draws for each key, and who does not know the key cannot prepare
for them. Anyone can look: `crowdbench evaluate eth-v0 --policy mine.onnx --spawn
perturbed-replay`.

**Copied courses.** Under the recorded arrivals, each trip of at least {shortest:g} s is compared
with the path of the same person in the recording, both without their trend (a polynomial of degree
three in time). Start and goal say where a person walks on the whole; what is left, the small turns
and changes of pace, nobody can know who has not seen the path. A trip is copied if this correlates
above {similar:g}, for the best delay of up to {lag:g} s, rotation and reflection.

The tables have the score *walk* (protocol full) under the recorded and the perturbed arrivals
({draws} draws), and the share of copied trips. The first rows are honest policies. The others are
copies that recognise recorded people, and walk by social forces where they recognise nobody;
*nearest trip* takes the most similar recorded trip for everybody, turned and stretched to fit.
Among people who never came, no copy comes near to the best honest policy. Honest policies lose
something there, too, social forces most. Each copy that scores well under the recorded arrivals
has far more copied trips than any honest policy.

The leaderboard ranks policies under perturbed arrivals, with a key that is drawn when a submission
is judged, and flags copied trips. Copied arrivals are found by what the last table shows.

This page is the output of `python -m studies copies`."""


class Judged(NamedTuple):
    """What a policy gets on a scene."""

    name: str
    recorded: Score | None
    """Score under the recorded arrivals."""
    perturbed: Score | None
    trips: float | None
    """Share of copied trips, see `path_copies`."""


def judged(scene: str | Path | Scene, honest: Sequence[str]) -> list[Judged]:
    """Judge honest policies, by name, and then the copies, in protocol `full`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    walkers: list[tuple[str, Policy]] = [(name, find_policy(name, place)) for name in honest]
    walkers += [(copy.name, copy) for copy in copies_of(place)]
    return [_judged(place, name, walker) for name, walker in walkers]


def _judged(place: Scene, name: str, walker: Policy) -> Judged:
    reference, scale = reference_of(place), read_anchors(place).protocols["full"]
    recording = recording_of(place)
    trips = None
    scores: list[Score | None] = []
    for arrivals in ARRIVALS:
        rolled = {}
        for seed in range(
            1 if arrivals == "replay" and getattr(walker, "deterministic", False) else DRAWS
        ):
            crowd = rollout(place, spawn_model(arrivals, place), walker, seed=seed)
            job = Job(place.id, arrivals, name, "full", 0, seed, Path(), "")
            rolled[job] = RolloutSummary.of_crowd(crowd, reference)
            if arrivals == "replay" and seed == 0:
                trips = PathCopies(recording, place).share(crowd)
        card = judge(place, reference, rolled, "full", DRAWS, scale)
        scores.append(next(row.walk for row in rows(card) if row.kind == "entry"))
    return Judged(name, scores[0], scores[1], trips)


def page(scenes: Sequence[str]) -> str:
    """The page as Markdown."""
    title = TITLE.format(
        time=TIME_S, start=START_M, goal=GOAL_M, speed=100 * SPEED, room=ROOM_M,
        shortest=SHORTEST_S, similar=SIMILAR, lag=LAG_S, draws=DRAWS,
    )  # fmt: skip
    tables = []
    for scene in scenes:
        lines = [
            [each.name, interval(each.recorded), interval(each.perturbed), share(each.trips)]
            for each in judged(scene, HONEST)
        ]
        head = ["policy", "recorded arrivals", "perturbed arrivals", "copied trips"]
        tables.append(f"## {load_scene(scene).title} ({scene})\n\n{table(head, lines, text=1)}")
    return flowed(title) + "\n" + "\n\n".join([*tables, copied_arrivals.section(scenes)]) + "\n"
