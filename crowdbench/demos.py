"""What recorded people saw and did: state-action pairs to learn a policy from.

The recording is replayed in the simulation that environments stand on, everyone along its recorded
path, and what each person sees there is written down beside the action that takes it on. So the
pairs are those of the environment, observation for observation, walls and speed limit included.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.episode import actions_of, begin, check_capacity, generator
from crowdbench.errors import SettingError
from crowdbench.policies import ReplayPolicy
from crowdbench.reference import blocks_of
from crowdbench.registry import recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import Replay
from crowdbench.spawn.weights import check_part
from crowdbench.trajectories import Trajectories

if TYPE_CHECKING:
    from imitation.data.types import Trajectory


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """`L` lives or pieces of lives, `S` state-action pairs.

    A life is cut where it leaves the blocks that a part of the recording is fitted on.
    """

    observations: Float32[np.ndarray, "R obs"]
    """R = S + L: after the observations of each piece, one of where its last action leads."""
    actions: Float32[np.ndarray, "R 2"]
    """Velocity in units of the scene's greatest speed; NaN in the last row of each piece."""
    person: Int[np.ndarray, " L"]
    """Index of the person in the recording."""
    offsets: Int[np.ndarray, " L+1"]
    """Rows of piece k are offsets[k] … offsets[k + 1] − 1."""
    first: Int[np.ndarray, " L"]
    """Frame of each piece's first row."""
    complete: Bool[np.ndarray, " L"]
    """Whether the piece ends where the person left, or is cut off."""

    def __len__(self) -> int:
        return len(self.person)

    def pairs(self) -> tuple[Float32[np.ndarray, "S obs"], Float32[np.ndarray, "S 2"]]:
        """All observations, and the actions taken in them."""
        acted = ~np.isnan(self.actions[:, 0])
        return self.observations[acted], self.actions[acted]

    def take(self, pieces: Sequence[int] | Int[np.ndarray, " l"]) -> "Demonstrations":
        """Some of the pieces, by index."""
        chosen = np.asarray(pieces, dtype=np.int64)
        length = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(length)])
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], length)
        rows = np.repeat(self.offsets[:-1][chosen], length) + within
        return Demonstrations(
            self.observations[rows],
            self.actions[rows],
            self.person[chosen],
            offsets,
            self.first[chosen],
            self.complete[chosen],
        )

    def split(self, share: float, seed: int) -> tuple["Demonstrations", "Demonstrations"]:
        """Two lots, the second of about that share of the persons: nobody is in both."""
        persons = np.unique(self.person)
        chosen = np.random.default_rng(seed).random(len(persons)) < share
        second = np.isin(self.person, persons[chosen])
        return self.take(np.flatnonzero(~second)), self.take(np.flatnonzero(second))

    def to_imitation(self) -> "list[Trajectory]":
        """The pieces as `imitation`'s trajectories; needs the extra `imitation`."""
        from imitation.data.types import Trajectory

        return [
            Trajectory(
                obs=self.observations[start:stop],
                acts=self.actions[start : stop - 1],
                infos=None,
                terminal=bool(complete),
            )
            for start, stop, complete in zip(
                self.offsets[:-1].tolist(), self.offsets[1:].tolist(), self.complete, strict=True
            )
        ]


def demonstrations(
    scene: str | Scene,
    *,
    part: str = "full",
    observation: str = "lidar-2",
    rays: int = 32,
    ray_range_m: float = 10.0,
    displaced_m: float = 0.0,
    recovery_s: float = 1.5,
    seed: int = 0,
) -> Demonstrations:
    """The demonstrations of a scene's recording in the blocks that `part` is fitted on.

    Who only ever saw people on their way does not know how to get back to it: a cloned policy
    drifts, and then is where no demonstration was. So half of the persons, drawn by chance, can be
    displaced: again and again each is somewhere beside its recorded path, at another velocity, and
    comes back as a critically damped spring of time constant τ does, with
    (δ + (ε + δ/τ) t) exp(−t/τ) from where it was recorded after t. (Laskey et al. 2017, DART,
    CoRL, disturb the demonstrator for the same reason.) What displaced people do is as smooth as
    what was recorded: no displacement comes back in one step, which would look like unrest.

    Args:
        scene: an id, or a scene.
        part: `full`, or `fold0` … for what a fold of the protocol `heldout` is fitted on, which
            knows nothing of the blocks it is scored on.
        observation: what they see, as in `parallel_env`; so are `rays` and `ray_range_m`.
        displaced_m: standard deviation of both components of δ, metres, and times 1/τ of those
            of ε; 0 for none.
        recovery_s: τ. A displacement lasts for 4 τ, and fades in the last τ before the record's
            end.
        seed: of the displacements.

    Raises:
        RecordingError: the recording has not been imported.
        SceneError, SettingError: there is no such scene, part or observation.
    """
    place = load_scene(scene)
    check_part(part, 0)
    recording = recording_of(place)
    # A slot is free in the frame after the last, when others have entered already.
    most = 2 * int(recording.present().max())
    settings = Settings(max_alive=most, rays=rays, ray_range_m=ray_range_m, observation=observation)
    simulation = Simulation(place, settings=settings)
    walker = ReplayPolicy(recording)
    begin(
        simulation,
        Replay(recording),
        seed=0,
        frames=recording.frames,
        start="recorded",
        walker=walker,
        scripted=True,
    )
    walker.reset(place, generator(0, 0, "policy"))
    for name, value, least in (("displaced_m", displaced_m, 0), ("recovery_s", recovery_s, 1e-3)):
        if not (np.isfinite(value) and value >= least):
            raise SettingError(name, got=str(value), expected=f"a finite number from {least:g} on")
    aside = _Aside.of(recording, displaced_m, recovery_s, seed)
    last = recording.offsets[1:] - 1
    step_m = place.dt_s * place.motion.max_speed_mps
    inside = _trained_on(blocks_of(recording, place).training(part).frames, recording.frames)

    person: list[np.ndarray] = []
    frame: list[np.ndarray] = []
    observations: list[np.ndarray] = []
    actions: list[np.ndarray] = []
    slots = simulation.slots
    for t in range(recording.frames):
        actions_now = actions_of(walker, simulation)
        if inside[t]:
            there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
            event = slots.event[0, there]
            person.append(event)
            frame.append(np.full(len(there), t))
            now = actions_now[0, there]
            stood, went = slots.position[0, there], slots.velocity[0, there]
            row = np.minimum(recording.offsets[event] + t - recording.first[event], last[event])
            after = np.minimum(row + 1, last[event])
            here = (stood + aside.now[row]).astype(np.float64)
            moved = aside.now[row].any(axis=1) | aside.after[row].any(axis=1)
            moved &= place.walkable(here) & place.walkable(recording.xy[after] + aside.after[row])
            slots.position[0, there[moved]] = here[moved]
            slots.velocity[0, there[moved]] += aside.drift[row[moved]].astype(np.float32)
            observations.append(simulation.observe()[0, there])
            slots.position[0, there], slots.velocity[0, there] = stood, went
            way = recording.xy[after] + aside.after[row] - here
            now[moved] = (way / step_m).clip(-1, 1)[moved]
            now[~slots.alive[0, there]] = np.nan
            actions.append(now)
        simulation.step(actions_now)
    check_capacity(simulation)
    return _pieces(
        np.concatenate(person),
        np.concatenate(frame),
        np.concatenate(observations),
        np.concatenate(actions),
        np.where(recording.left, recording.last, -1),
    )


@dataclass(frozen=True, eq=False)
class _Aside:
    """Where each row of a recording is shown instead, beside its place, and how fast."""

    now: Float[np.ndarray, "R 2"]
    """Metres."""
    drift: Float[np.ndarray, "R 2"]
    """Added to the velocity, m/s."""
    after: Float[np.ndarray, "R 2"]
    """Where its action leads to, beside the next row's place, metres."""

    @classmethod
    def of(
        cls, recording: Trajectories, displaced_m: float, recovery_s: float, seed: int
    ) -> "_Aside":
        """Half of the persons are on a spring at each time, a new one after 4 τ."""
        shape = (len(recording.xy), 2)
        found = cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        rng = np.random.default_rng(seed)
        chosen = rng.random(len(recording)) < 0.5
        if displaced_m == 0:
            return found
        dt_s, every = recording.dt_s, max(1, round(4 * recovery_s / recording.dt_s))
        for person in np.flatnonzero(chosen).tolist():
            rows = slice(*recording.offsets[person : person + 2].tolist())
            length = rows.stop - rows.start
            k, step = np.divmod(np.arange(length) + int(rng.integers(every)), every)
            delta, epsilon = rng.normal(0.0, displaced_m, (2, k[-1] + 1, 2))[:, k]
            rate = (epsilon + delta) / recovery_s
            left_s = np.arange(length - 1, -1, -1) * dt_s

            def spring(ahead: int) -> np.ndarray:
                t = (step + ahead)[:, None] * dt_s  # noqa: B023  # called before they change
                fade = np.clip((left_s - ahead * dt_s) / recovery_s, 0, 1)[:, None]  # noqa: B023
                return (delta + rate * t) * np.exp(-t / recovery_s) * fade  # noqa: B023

            found.now[rows], found.after[rows] = spring(0), spring(1)
            # Also of who has just been displaced: as if it had come along the same spring.
            found.drift[rows] = (found.now[rows] - spring(-1)) / dt_s
        return found


def _trained_on(blocks: Int[np.ndarray, "B 2"], frames: int) -> Bool[np.ndarray, " frames"]:
    inside = np.zeros(frames, dtype=bool)
    for start, stop in blocks.tolist():
        inside[start:stop] = True
    return inside


def _pieces(
    person: Int[np.ndarray, " n"],
    frame: Int[np.ndarray, " n"],
    observations: Float32[np.ndarray, "n obs"],
    actions: Float32[np.ndarray, "n 2"],
    last: Int[np.ndarray, " P"],
) -> Demonstrations:
    """Rows sorted into runs of frames of one person; runs of one row show no action."""
    order = np.lexsort((frame, person))
    person, frame = person[order], frame[order]
    begins = (np.diff(person, prepend=-1) != 0) | (np.diff(frame, prepend=-2) != 1)
    run = np.cumsum(begins) - 1
    length = np.bincount(run)
    kept = length[run] > 1
    order, begins = order[kept], begins[kept]
    person, frame = person[kept], frame[kept]
    length = length[length > 1]
    offsets = np.concatenate([[0], np.cumsum(length)])
    observations, actions = observations[order], actions[order]
    actions[offsets[1:] - 1] = np.nan
    whose = person[begins].astype(np.int64)
    ends = frame[offsets[1:] - 1]
    return Demonstrations(observations, actions, whose, offsets, frame[begins], ends == last[whose])
