"""`rollout`: a crowd from a spawn model and a policy, as `Trajectories`."""

from dataclasses import replace
from typing import Any

from crowdbench.errors import SettingError
from crowdbench.policies import Policy, ReplayPolicy
from crowdbench.rollouts.episode import Recorder, actions_of, begin, check_capacity, generator
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
    """Let `spawn` people the scene and `policy` walk them for `horizon_s` seconds.

    The same seed gives the same table. `horizon_s` is by default the recording's length and
    `start` the spawn model's; a warm-up is walked by `policy` too. With both `replay`, people
    leave at their recorded last frame; otherwise reaching the goal ends a life. A policy that
    sees observations may say which, by its attributes `observation`, `rays` and `ray_range_m`.

    Raises:
        SettingError: `start` does not fit the spawn model, or the policy `replay` does not.
        CapacityError: more people than slots.
        RecordingError: nobody came.
    """
    # By what they are, not by what they are called: a network's file says its own name. Subclasses
    # (`walks.RecordedPaths`) walk recorded paths, but arrive as all others do.
    replaying = type(policy) is ReplayPolicy
    if replaying and (not isinstance(spawn, Replay) or start == "empty"):
        raise SettingError(
            "policy replay",
            got=f"spawn model {spawn.name}, start {start or spawn.start}",
            expected="the spawn model replay, start recorded",
            hint="Only then is each person one of the recording.",
        )
    settings = settings or settings_for(policy)
    simulation = Simulation(scene, settings=settings)
    frames = scene.frames(scene.horizon_s if horizon_s is None else horizon_s)
    begin(
        simulation,
        spawn,
        seed=seed,
        frames=frames,
        start=start,
        walker=policy,
        scripted=replaying,
    )
    policy.reset(scene, generator(seed, 0, "policy"))
    recorder = Recorder(simulation)
    recorder.write()
    for _ in range(frames):
        simulation.step(actions_of(policy, simulation))
        recorder.write()
    check_capacity(simulation)
    provenance: dict[str, Any] = {"spawn": spawn.name, "policy": policy.name, "seed": int(seed)}
    return recorder.trajectories(provenance)


def settings_for(policy: Policy) -> Settings:
    """A simulation that shows a policy what it says it sees, `lidar-2` by default."""
    default = Settings(max_alive=MAX_ALIVE)
    if policy.sees == "state":
        return default
    asked = {
        name: getattr(policy, name, getattr(default, name))
        for name in ("observation", "rays", "ray_range_m")
    }
    return replace(default, **asked)
