"""Demonstrations: observations and actions of recorded people, for imitation learning.

The recording is replayed in the simulation of the environments. Everyone follows the recorded path,
or is moved by a policy that stays near it, and each observation is stored with the action that
leads to the next recorded position. Observations, walls and the speed limit are therefore the same
as in the environments, and so are companions, stops and preferred speeds, which are those of the
spawn model `replay`. Actions are in the frame of the observation.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench import __version__, registry
from crowdbench.data.recordings.catalogue import source
from crowdbench.data.smoothing import smoothed
from crowdbench.data.stops import STANDING_MPS
from crowdbench.envs.closed_loop import NearestCandidate
from crowdbench.envs.demonstrated_trips import Demonstrations, Rows, pieces_of
from crowdbench.envs.perturbation import HOMING_S, PathPerturbation
from crowdbench.envs.recorded_paths import RecordedContinuation
from crowdbench.errors import SettingError
from crowdbench.policies import Policy
from crowdbench.policies.memory import Needs
from crowdbench.run.acting import settings_for
from crowdbench.run.episode import begin, check_capacity, generator
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.simulation import check_count
from crowdbench.simulation.social import in_own_frame
from crowdbench.spawn import Replay
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.fits import check_split

__all__ = ["Demonstrations", "demonstrations"]

CANDIDATES = 3
"""Default number of actions that a policy draws for each person and decision."""
RECOVERY_S = 1.5
"""Default time constant of displacements, seconds."""


def demonstrations(
    scene: str | Path | Scene,
    *,
    split: str = "full",
    observation: str = OBSERVATION,
    rays: int = 32,
    ray_range_m: float = 10.0,
    interval: int | None = None,
    policy: str | Policy | None = None,
    candidates: int = CANDIDATES,
    smoothing_s: float = 0.0,
    displaced_m: float = 0.0,
    recovery_s: float | None = None,
    seed: int = 0,
) -> Demonstrations:
    """Demonstrations of a scene's recording, from the time blocks on which `split` is fitted.

    With an `interval` of k frames, people decide in their first frame and in every k-th frame after
    it, as in a rollout of a policy with this interval. There is a row for each decision. Its action
    is the mean velocity until the next decision, and people keep this velocity in between.

    A cloned policy drifts away from the recorded paths into states without demonstrations. There
    are two ways to show how to return:

    - `policy`: everyone is moved by a policy, in closed loop. In each decision the policy draws
      `candidates` actions for each person. The person walks the one that ends nearest to its
      recorded position at the next decision; the action that is shown leads from where the person
      is to that position, at most at the maximum speed (Zhang et al. 2025, CVPR, arXiv:2412.05334).
      With `recovery_s` = τ it leads back more smoothly: the deviation decays by the share dt/τ in a
      decision of dt seconds, except in the last 2 s, in which it leads to the last position.
      Everyone enters and leaves when recorded. `deviation_m` tells how far people are from their
      recorded positions. Those who are farther than 3 m walk back, whatever the policy does. Train
      on these demonstrations together with those of the recording.
    - `displaced_m`: a random half of the persons is displaced repeatedly: each displacement starts
      at an offset δ from the recorded path with an additional velocity ε, and decays like a
      critically damped spring with time constant τ. At time t the person is
      (δ + (ε + δ/τ) t) exp(−t/τ) away from the recorded position. (Laskey et al. 2017, DART, CoRL,
      disturb the demonstrator for the same reason.) The displaced motion is as smooth as the
      recorded one; a return in a single step would look like restless motion. In their last 2 s,
      displaced people walk straight to the last recorded position. People who stand still are not
      displaced.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        split: `full`, or `fold0`, `fold1`, … for the training data of a fold of the protocol
            `heldout`, which exclude the blocks that the fold is scored on.
        observation: version of the observation, as in `parallel_env`.
        rays: number of rays.
        ray_range_m: range of the rays in metres.
        interval: number of frames between two decisions; default: that of the policy, or 1.
        policy: a policy that moves everyone, as in `crowdbench.policy`, trained on `split` if there
            is one for each split. If it sees observations, they must be those asked for.
        candidates: number of actions that the policy draws. It is called once for all of them: each
            person is in so many rows of the batch.
        smoothing_s: window in which recorded positions are smoothed, in seconds, as in
            `crowdbench.data.smoothing.smoothed`; 0: not at all. Without it, actions contain
            the noise of annotations, and sampled walkers tremble.
        displaced_m: standard deviation σ of each component of δ in metres; each component of ε has
            σ/τ. 0: no displacements.
        recovery_s: τ in seconds. Each displacement lasts for 4 τ and is followed by another one;
            default: 1.5, or 0 with a policy.
        seed: random seed of the displacements, or of the policy.

    Raises:
        RecordingError: the recording is not imported.
        SceneError, SettingError: the scene, split, observation or policy does not exist, the policy
            has another observation or interval, or a number is out of range.
        WeightsError: the file of the policy is missing or invalid.
        ActionError: the policy does not return one finite action per row.
    """
    place = load_scene(scene)
    check_split(split, 0)
    if recovery_s is None:
        recovery_s = 0.0 if policy is not None else RECOVERY_S
    least_s = 0 if policy is not None else 1e-3
    for name, value, least in (
        ("smoothing_s", smoothing_s, 0),
        ("displaced_m", displaced_m, 0),
        ("recovery_s", recovery_s, least_s),
    ):
        if not (np.isfinite(value) and value >= least):
            raise SettingError(
                name, got=str(value), expected=f"a finite number of at least {least:g}"
            )
    for name, count in (("interval", interval), ("candidates", candidates)):
        if count is not None:
            check_count(name, count)
    if policy is not None and displaced_m > 0:
        raise SettingError("demonstrations", got="displaced_m and a policy", expected="one of them")
    recording = smoothed(registry.recording_of(place), smoothing_s)
    # A slot becomes free only in the frame after the last, when others have already entered.
    most = 2 * int(recording.present().max())
    settings = Settings(max_alive=most, rays=rays, ray_range_m=ray_range_m, observation=observation)
    walker = None if policy is None else registry.policy(policy, place, split)
    if walker is not None:
        interval = _interval(walker, settings, interval)
    simulation = Simulation(place, settings=settings)
    recorded = RecordedContinuation(recording, place.motion.max_speed_mps, interval or 1)
    mover: Any = recorded  # of one of three protocols
    if walker is not None:
        mover = NearestCandidate(walker, candidates, simulation, recorded)
    aside = None
    if displaced_m > 0:
        aside = PathPerturbation.of(recording, displaced_m, recovery_s, seed, recorded.interval)
    watched = _Watched(simulation, recorded, aside, recovery_s if walker is not None else 0.0)
    watched.replay(mover, split, seed)
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
        "interval": int(recorded.interval),
        "smoothing_s": smoothing_s,
        "displaced_m": displaced_m,
        "recovery_s": recovery_s,
        "seed": seed,
    }
    if walker is not None:
        provenance |= {"policy": walker.name, "candidates": int(candidates)}
    left = np.where(recording.left, recording.last, -1)
    return pieces_of(watched.rows, recording.first, left, provenance)


def _interval(policy: Policy, settings: Settings, interval: int | None) -> int:
    """The interval of a policy, whose observation and interval must be those asked for."""
    where, own = f"policy {policy.name}", 1
    if policy.sees == "observation":
        own = Needs.of(policy).interval
        settings_for(policy, settings, hint="Ask for demonstrations with {name}={value!r}.")
    if interval not in (None, own):
        raise SettingError(
            where,
            got=f"decisions every {own} frames",
            expected=f"every {interval}, as in the demonstrations",
            hint=f"Ask for demonstrations with interval={own}.",
        )
    return own


@dataclass(frozen=True, eq=False)
class _Watched:
    """Everyone in a simulation of recorded people, and the rows that were written of them."""

    simulation: Simulation
    recorded: RecordedContinuation
    aside: PathPerturbation | None
    recovery_s: float
    """Time constant with which actions lead back to recorded positions; 0: at once."""
    rows: list[Rows] = field(default_factory=list)

    def replay(self, mover: Any, split: str, seed: int) -> None:
        """Let a policy move the recorded people; write the rows on which `split` is trained."""
        simulation, recording = self.simulation, self.recorded.recording
        actor = begin(
            simulation,
            Replay(recording),
            seed=0,
            frames=recording.frames,
            start="recorded",
            walker=mover,
            scripted=True,
        )
        actor.reset(generator(seed, 0, "policy"))
        blocks = blocks_of(recording, simulation.scene).training(split)
        inside = np.zeros(recording.frames, dtype=bool)
        for start, stop in blocks.frames.tolist():
            inside[start:stop] = True
        for frame in range(recording.frames):
            actions = actor.actions()
            if actor.world_frame and simulation.settings.own_frame:  # rounded as in environments
                actions = in_own_frame(actions, simulation.slots.heading)
            if inside[frame]:
                self.write(frame, seen=not actor.world_frame)
            simulation.step(actions)
        check_capacity(simulation)

    def write(self, frame: int, *, seen: bool) -> None:
        """Write a row for everyone who decides in this frame or has just left.

        `seen`: the observations of those who are present have just been computed.
        """
        simulation, recorded, slots = self.simulation, self.recorded, self.simulation.slots
        there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
        person, alive = slots.event[0, there], slots.alive[0, there]
        age = frame - slots.born[0, there]
        position, beside = slots.position[0, there], np.zeros((len(there), 2))
        before = [state[0, there] for state in (slots.position, slots.velocity, slots.heading)]
        if self.aside is not None:
            position, beside = self._displace(self.aside, frame, there)
        elif self.recovery_s > 0:
            beside = self._recovering(person, frame, position)
        if self.aside is not None or not (seen and alive.any()):
            simulation.observe()
        actions = recorded.action(person, frame, position, beside)
        if simulation.settings.own_frame:
            actions = in_own_frame(actions, slots.heading[0, there])
        actions = actions.clip(-1, 1)
        actions[~alive] = np.nan
        slots.position[0, there], slots.velocity[0, there], slots.heading[0, there] = before
        due = ~alive | (age % recorded.interval == 0)
        rows = Rows(
            person=person,
            frame=np.full(len(person), frame),
            step=-(-age // recorded.interval),  # rounded up
            observations=simulation.observation[0, there],
            actions=actions,
            deviation_m=recorded.deviation_m(person, frame, position),
        )
        self.rows.append(Rows(*(column[due] for column in rows)))

    def _recovering(
        self, person: Int[np.ndarray, " n"], frame: int, position: Float32[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n 2"]:
        """What is left of the deviations from the recorded positions at the next decisions."""
        recorded = self.recorded
        recording, row = recorded.recording, recorded.row(person, frame)
        frames = recorded.following(person, frame)[1]
        left = np.maximum(0, 1 - frames * recording.dt_s / self.recovery_s)
        to_end = recording.offsets[person + 1] - 1 - row
        left[to_end * recording.dt_s <= HOMING_S] = 0
        off: np.ndarray = position.astype(np.float64) - recording.xy[row]
        return off * left[:, None]

    def _displace(
        self, aside: PathPerturbation, frame: int, there: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
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
        slots.velocity[0, there[moved]] += aside.drift[row[moved]].astype(np.float32)
        slots.heading[0, there] = _headings(
            slots.velocity[0, there], slots.heading[0, there], moved
        )
        return np.where(moved[:, None], here, stood), np.where(moved[:, None], beside, 0.0)


def _headings(
    velocity: Float32[np.ndarray, "n 2"],
    heading: Float32[np.ndarray, "n 2"],
    moved: Bool[np.ndarray, " n"],
) -> Float32[np.ndarray, "n 2"]:
    """Headings of people with displaced velocities; those who stand keep theirs."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    turned = moved[:, None] & (speed >= STANDING_MPS)
    return np.where(turned, velocity / np.maximum(speed, STANDING_MPS), heading)


def _cite(name: str) -> str:
    """The paper to cite for a recording; empty for generated recordings and users' own."""
    try:
        return source(name).cite
    except SettingError:
        return ""
