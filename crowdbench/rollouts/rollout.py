"""`rollout`: simulate a crowd of a spawn model and a policy."""

from dataclasses import replace
from typing import Any

from crowdbench.errors import SettingError
from crowdbench.policies import Policy, ReplayPolicy
from crowdbench.rollouts.episode import Recorder, begin, check_capacity, generator
from crowdbench.scene import Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import Replay, SpawnModel
from crowdbench.spawn.model import Start
from crowdbench.trajectories.table import Trajectories

MAX_ALIVE = 4096


def rollout(
    scene: Scene,
    spawn: SpawnModel,
    policy: Policy,
    *,
    seed: int,
    horizon_s: float | None = None,
    start: Start | None = None,
    settings: Settings | None = None,
) -> Trajectories:
    """Simulate a crowd: `spawn` draws the arrivals and `policy` moves the people.

    Returns the trajectories of `horizon_s` seconds. The same seed gives the same table. `horizon_s`
    defaults to the length of the recording and `start` to that of the spawn model. A warm-up uses
    `policy` too. If spawn model and policy are both `replay`, people leave in their last recorded
    frame; otherwise they leave when they reach the goal. A policy with `sees = "observation"` may
    choose its observation by the attributes `observation`, `rays` and `ray_range_m`.

    Raises:
        SettingError: `start` or the policy `replay` does not fit the spawn model.
        ActionError: the policy does not return one finite action per person.
        CapacityError: there are more people than slots.
        RecordingError: nobody entered.
    """
    # The type is tested, not the name, because the file of a network may have any name.
    if isinstance(policy, ReplayPolicy) and (not isinstance(spawn, Replay) or start == "empty"):
        raise SettingError(
            f"policy {policy.name}",
            got=f"spawn model {spawn.name}, start {start or spawn.start}",
            expected="the spawn model replay, start recorded",
            hint=f"The policy {policy.name} needs the recorded arrivals.",
        )
    # Its subclass `RecordedPaths` follows recorded paths, but leaves as all other policies do.
    replaying = type(policy) is ReplayPolicy
    settings = settings or settings_for(policy)
    simulation = Simulation(scene, settings=settings)
    frames = scene.frames(scene.horizon_s if horizon_s is None else horizon_s)
    actor = begin(
        simulation,
        spawn,
        seed=seed,
        frames=frames,
        start=start,
        walker=policy,
        scripted=replaying,
    )
    actor.reset(generator(seed, 0, "policy"))
    recorder = Recorder(simulation)
    recorder.write()
    for _ in range(frames):
        actor.step()
        recorder.write()
    check_capacity(simulation)
    provenance: dict[str, Any] = {"spawn": spawn.name, "policy": policy.name, "seed": int(seed)}
    return recorder.trajectories(provenance)


def settings_for(policy: Policy) -> Settings:
    """Settings of a simulation with the observation of a policy, by default `lidar-2`."""
    default = Settings(max_alive=MAX_ALIVE)
    if policy.sees == "state":
        return default
    asked = {
        name: getattr(policy, name, getattr(default, name))
        for name in ("observation", "rays", "ray_range_m")
    }
    return replace(default, **asked)
