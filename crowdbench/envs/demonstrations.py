"""Demonstrations: observations and actions of recorded people, for imitation learning.

The recording is replayed in the simulation of the environments. Everyone follows the recorded path,
and each observation is stored with the action that leads to the next recorded position.
Observations, walls and the speed limit are therefore the same as in the environments, and so are
companions, stops and preferred speeds, which are those of the spawn model `replay`. Actions are in
the frame of the observation.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench import __version__, registry
from crowdbench.data.recordings.catalogue import source
from crowdbench.data.stops import STANDING_MPS
from crowdbench.data.table import Indices, Points, Trajectories
from crowdbench.envs.demonstrated_trips import Demonstrations, Rows, pieces_of
from crowdbench.envs.perturbation import PathPerturbation
from crowdbench.errors import SettingError, checked
from crowdbench.policies import StateView
from crowdbench.run.episode import begin, check_capacity
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.simulation import check_count
from crowdbench.simulation.social import in_own_frame
from crowdbench.spawn import Replay
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.fits import check_split

__all__ = ["Demonstrations", "demonstrations"]

RECOVERY_S = 1.5
"""Default time constant of displacements, seconds."""
_DEGREE = 2  # of the polynomials that smooth paths: a constant acceleration is not changed


@checked()
def demonstrations(
    scene: str | Path | Scene,
    *,
    split: str = "full",
    observation: str = OBSERVATION,
    rays: int = 32,
    ray_range_m: float = 10.0,
    interval: int = 1,
    smoothing_s: float = 0.0,
    displaced_m: float = 0.0,
    recovery_s: float = RECOVERY_S,
    seed: int = 0,
) -> Demonstrations:
    """Demonstrations of a scene's recording, from the time blocks on which `split` is fitted.

    With an `interval` of k frames, people decide in their first frame and in every k-th frame after
    it, as in a rollout of a policy with this interval. There is a row for each decision. Its action
    is the mean velocity until the next decision, and people keep this velocity in between.

    A cloned policy drifts away from the recorded paths into states without demonstrations. With
    `displaced_m`, demonstrations show how to return: a random half of the persons is displaced
    repeatedly. Each displacement starts at an offset δ from the recorded path with an additional
    velocity ε, and decays like a critically damped spring with time constant τ. At time t the
    person is (δ + (ε + δ/τ) t) exp(−t/τ) away from the recorded position. (Laskey et al. 2017,
    DART, CoRL, disturb the demonstrator for the same reason.) The displaced motion is as smooth as
    the recorded one; a return in a single step would look like restless motion. In their last 2 s,
    displaced people walk straight to the last recorded position. People who stand still are not
    displaced.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        split: `full`, or `fold0`, `fold1`, … for the training data of a fold of the protocol
            `heldout`, which exclude the blocks that the fold is scored on.
        observation: version of the observation, as in `parallel_env`.
        rays: number of rays.
        ray_range_m: range of the rays in metres.
        interval: number of frames between two decisions.
        smoothing_s: window in which recorded positions are smoothed, in seconds, as in `smoothed`;
            0: not at all. Without it, actions contain the noise of annotations, and sampled
            walkers tremble.
        displaced_m: standard deviation σ of each component of δ in metres; each component of ε has
            σ/τ. 0: no displacements.
        recovery_s: τ in seconds. Each displacement lasts for 4 τ and is followed by another one.
        seed: random seed of the displacements.

    Raises:
        RecordingError: the recording is not imported.
        SceneError, SettingError: the scene, split or observation does not exist, or a number is out
            of range.
    """
    place = load_scene(scene)
    check_split(split, 0)
    for name, value, least in (
        ("smoothing_s", smoothing_s, 0),
        ("displaced_m", displaced_m, 0),
        ("recovery_s", recovery_s, 1e-3),
    ):
        if not (np.isfinite(value) and value >= least):
            raise SettingError(
                name, got=str(value), expected=f"a finite number of at least {least:g}"
            )
    check_count("interval", interval)
    recording = smoothed(registry.recording_of(place), smoothing_s)
    # A slot becomes free only in the frame after the last, when others have already entered.
    most = 2 * int(recording.present().max())
    settings = Settings(max_alive=most, rays=rays, ray_range_m=ray_range_m, observation=observation)
    simulation = Simulation(place, settings=settings)
    recorded = _RecordedContinuation(recording, place.motion.max_speed_mps, interval)
    aside = None
    if displaced_m > 0:
        aside = PathPerturbation.of(recording, displaced_m, recovery_s, seed, interval)
    watched = _Watched(simulation, recorded, aside)
    watched.replay(split)
    provenance = {
        "version": __version__,
        "scene": place.id,
        "recording": place.recording.name,
        "sha256": recording.provenance.get("sha256", ""),
        "cite": _cite(place.recording.name),
        "dt_s": place.dt_s,
        "max_speed_mps": place.motion.max_speed_mps,
        "split": split,
        "observation": observation,
        "rays": rays,
        "ray_range_m": ray_range_m,
        "interval": int(interval),
        "smoothing_s": smoothing_s,
        "displaced_m": displaced_m,
        "recovery_s": recovery_s,
        "seed": seed,
    }
    left = np.where(recording.left, recording.last, -1)
    return pieces_of(watched.rows, recording.first, left, provenance)


def smoothed(recording: Trajectories, window_s: float) -> Trajectories:
    """The recording with positions from a Savitzky-Golay filter of degree 2.

    Each position is that of the quadratic that fits best within a window of `window_s` seconds
    around it (Savitzky & Golay 1964, Analytical Chemistry 36, 1627), at the ends of a path within
    its first or last window. Paths that are shorter than the window are fitted as a whole. The
    first position of each path is kept. Windows of less than five frames change nothing.
    """
    frames = 2 * round(window_s / recording.dt_s / 2) + 1
    if frames <= _DEGREE + 1:
        return recording
    from scipy.signal import savgol_filter

    xy = recording.xy.astype(np.float64)
    for start, stop in zip(recording.offsets[:-1], recording.offsets[1:], strict=True):
        width = min(frames, (stop - start - 1) // 2 * 2 + 1)
        if width > _DEGREE + 1:
            path = savgol_filter(xy[start:stop], width, _DEGREE, axis=0, mode="interp")
            xy[start + 1 : stop] = path[1:]
    return replace(recording, xy=xy.astype(recording.xy.dtype))


@dataclass(frozen=True, eq=False)
class _RecordedContinuation:
    """Leads people straight to their recorded positions at their next decisions.

    A person decides in its first frame and in each `interval`-th frame after it. Where its record
    ends in between, the person is led to its last position in the frames that are left.

    It is also the policy that moves everyone along the recorded paths; like `ReplayPolicy`, it
    needs the spawn model `replay`.
    """

    recording: Trajectories
    max_speed_mps: float
    interval: int = 1
    """Number of frames between two decisions."""
    name: ClassVar[str] = "recorded-continuation"
    sees: ClassVar[Literal["state"]] = "state"

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode; there are no random draws."""

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) with which everyone is at its recorded position at its next decision."""
        return self.action(seen.event, seen.frame, seen.position)

    def row(self, person: Indices, frame: int | Indices) -> Indices:
        """Row of `recording.xy` of each person in a frame; its last row after its end."""
        return self._at(person, frame - self.recording.first[person])

    def following(self, person: Indices, frame: int | Indices) -> tuple[Indices, Indices]:
        """Row of each person at its next decision after a frame, and the frames until then.

        After the end of its record, these are its last row and 1.
        """
        age = frame - self.recording.first[person]
        row = self._at(person, (age // self.interval + 1) * self.interval)
        return row, np.maximum(row - self._at(person, age), 1)

    def action(
        self,
        person: Int[np.ndarray, " n"],
        frame: int | Int[np.ndarray, " n"],
        position: Float[np.ndarray, "n 2"],
        aside: Float[np.ndarray, "n 2"] | float = 0.0,
    ) -> Float32[np.ndarray, "n 2"]:
        """Action in the world frame that leads from a position to that at the next decision.

        `aside` is added to the recorded position, metres. Actions are not clipped: those of people
        who are too far away to get there in time are beyond the maximum speed.
        """
        row, frames = self.following(person, frame)
        way = self.recording.xy[row].astype(np.float64) + aside - position
        way /= self.recording.dt_s * frames[:, None]
        return (way / self.max_speed_mps).astype(np.float32)

    def _at(self, person: Indices, age: Indices) -> Indices:
        offsets = self.recording.offsets
        return np.minimum(offsets[person] + age, offsets[person + 1] - 1)


@dataclass(frozen=True, eq=False)
class _Watched:
    """Everyone in a simulation of recorded people, and the rows that were written of them."""

    simulation: Simulation
    recorded: _RecordedContinuation
    aside: PathPerturbation | None
    rows: list[Rows] = field(default_factory=list)

    def replay(self, split: str) -> None:
        """Move people along their recorded paths; write the rows on which `split` is trained."""
        simulation, recording = self.simulation, self.recorded.recording
        actor = begin(
            simulation,
            Replay(recording),
            seed=0,
            frames=recording.frames,
            start="recorded",
            walker=self.recorded,
            scripted=True,
        )
        blocks = blocks_of(recording, simulation.scene).training(split)
        inside = np.zeros(recording.frames, dtype=bool)
        for start, stop in blocks.frames.tolist():
            inside[start:stop] = True
        for frame in range(recording.frames):
            actions = actor.actions()
            if simulation.settings.own_frame:  # rounded as in environments
                actions = in_own_frame(actions, simulation.slots.heading)
            if inside[frame]:
                self.write(frame)
            simulation.step(actions)
        check_capacity(simulation)

    def write(self, frame: int) -> None:
        """Write a row for everyone who decides in this frame or has just left."""
        simulation, recorded, slots = self.simulation, self.recorded, self.simulation.slots
        there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
        person, alive = slots.event[0, there], slots.alive[0, there]
        age = frame - slots.born[0, there]
        position, beside = slots.position[0, there], np.zeros((len(there), 2))
        states = (slots.position, slots.velocity, slots.commanded, slots.heading)
        before = [state[0, there] for state in states]
        if self.aside is not None:
            position, beside = self._displace(self.aside, frame, there)
        simulation.observe()
        actions = recorded.action(person, frame, position, beside)
        if simulation.settings.own_frame:
            actions = in_own_frame(actions, slots.heading[0, there])
        actions = actions.clip(-1, 1)
        actions[~alive] = np.nan
        for state, was in zip(states, before, strict=True):
            state[0, there] = was
        due = ~alive | (age % recorded.interval == 0)
        rows = Rows(
            person=person,
            frame=np.full(len(person), frame),
            step=-(-age // recorded.interval),  # rounded up
            observations=simulation.observation[0, there],
            actions=actions,
        )
        self.rows.append(Rows(*(column[due] for column in rows)))

    def _displace(
        self, aside: PathPerturbation, frame: int, there: Indices
    ) -> tuple[Points, Points]:
        """Displace the people in these slots.

        Returns where they are now, and by how much their actions lead beside their recorded
        positions. Distances walked and times stood remain those of the recorded path.
        """
        slots, place, recorded = self.simulation.slots, self.simulation.scene, self.recorded
        person = slots.event[0, there]
        row, (following, frames) = recorded.row(person, frame), recorded.following(person, frame)
        now, after = aside.now[row], aside.after[row]
        beside = after + (frames - 1)[:, None] * (after - now)
        stood = slots.position[0, there]
        here = (stood + now).astype(np.float64)
        moved = now.any(axis=1) | after.any(axis=1)
        moved &= place.walkable(here) & place.walkable(recorded.recording.xy[following] + beside)
        slots.position[0, there[moved]] = here[moved]
        drift = aside.drift[row[moved]].astype(np.float32)
        slots.velocity[0, there[moved]] += drift
        slots.commanded[0, there[moved]] += drift
        velocity, heading = slots.velocity[0, there], slots.heading[0, there]
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        turned = moved[:, None] & (speed >= STANDING_MPS)  # those who stand keep their headings
        slots.heading[0, there] = np.where(
            turned, velocity / np.maximum(speed, STANDING_MPS), heading
        )
        return np.where(moved[:, None], here, stood), np.where(moved[:, None], beside, 0.0)


def _cite(name: str) -> str:
    """The paper to cite for a recording; empty for generated recordings and users' own."""
    try:
        return source(name).cite
    except SettingError:
        return ""
