"""`rollout`: simulate a crowd of a spawn model and a policy."""

from collections.abc import Sequence

from crowdbench.data.blocks import HELD_OUT, SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.policies import Policy, ReplayPolicy
from crowdbench.policies.memory import Needs
from crowdbench.run.acting import needs, settings_for
from crowdbench.run.episode import (
    Recorder,
    World,
    check_capacity,
    check_horizon,
    draw,
    most_at_once,
)
from crowdbench.scene import Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import Replay, SpawnModel
from crowdbench.spawn.model import Start

MOST_REMEMBERED = 512
"""Numbers per person, beyond which crowds are not simulated together."""


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
    """Simulate a crowd, see `crowdbench.rollout`, of objects.

    A warm-up uses `policy` too. If spawn model and policy are both `replay`, people leave in their
    last recorded frame; otherwise they leave when they reach the goal.

    Raises:
        SettingError: `start` or the policy `replay` does not fit the spawn model, or the settings
            name another observation than the policy.
        ActionError: the policy does not return one finite action per person.
        CapacityError: there are more people than slots.
        RecordingError: nobody entered.
    """
    return _simulated(
        scene, [World(spawn, seed)], policy, horizon_s=horizon_s, start=start, settings=settings
    )[0]


def seed_of(split: str, seed: int) -> int:
    """The seed of a rollout: those of different splits must not share their random numbers."""
    return seed * len(SPLITS) + (0 if split == HELD_OUT else SPLITS.index(split))


Turn = tuple[int, Policy]
"""A frame, and the policy that acts from it on."""


def rollouts(
    scene: Scene,
    spawn: Sequence[SpawnModel],
    policy: Policy,
    *,
    seeds: Sequence[int],
    turns: Sequence[Turn] = (),
) -> list[Trajectories]:
    """Simulate one crowd for each spawn model and seed, each as `rollout` does.

    A policy with `many_worlds` is called for all crowds at once. The results of a network depend on
    the size of its batch in the last bits, so its crowds differ from those of `rollout`; the same
    models and seeds give the same crowds. At the frames of `turns`, other policies take over, which
    have the same needs (see `alike`).

    Raises:
        SettingError, ActionError, CapacityError, RecordingError: see `rollout`.
    """
    worlds = [World(*of) for of in zip(spawn, seeds, strict=True)]
    if batchable(policy):
        return _simulated(scene, worlds, policy, turns=turns)
    return [_simulated(scene, [world], policy, turns=turns)[0] for world in worlds]


def alike(policies: Sequence[Policy]) -> bool:
    """Whether these policies may take turns: same needs and observations, and no memory."""
    first, *others = [(Needs.of(policy), needs(policy)) for policy in policies]
    return first[0].memory == 0 and all(other == first for other in others)


def batchable(policy: Policy) -> bool:
    """Whether several rollouts may call this policy at once.

    A large memory is needed for each slot, and `many_worlds` is not inherited, because subclasses
    may draw random numbers or have a state of their own.
    """
    of = Needs.of(policy)
    return of.memory + of.style <= MOST_REMEMBERED and bool(
        vars(type(policy)).get("many_worlds", False)
    )


def _simulated(
    scene: Scene,
    worlds: Sequence[World],
    policy: Policy,
    *,
    horizon_s: float | None = None,
    start: Start | None = None,
    settings: Settings | None = None,
    turns: Sequence[Turn] = (),
) -> list[Trajectories]:
    if horizon_s is not None:
        check_horizon(horizon_s)
    spawn = worlds[0].spawn
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
    frames = scene.frames(scene.horizon_s if horizon_s is None else horizon_s)
    drawn = draw(scene, worlds, frames=frames, start=start, scripted=replaying)
    if settings is None:
        slots = max(most_at_once(events, scene) for events in drawn.events)
        settings = Settings(max_alive=max(1, slots))
    shown = settings_for(policy, settings)
    simulation = Simulation(scene, worlds=len(worlds), settings=shown)
    actor = drawn.begin(simulation, policy)
    generators = [world.generator("policy") for world in worlds]
    for _, other in turns:
        other.reset(scene, generators[0])
    actor.reset(*generators)
    turn = dict(turns)
    recorder = Recorder(simulation)
    recorder.write()
    for frame in range(frames):
        if (other_policy := turn.get(frame)) is not None:
            actor.hand_over(other_policy)
        actor.step()
        recorder.write()
    check_capacity(simulation)
    return recorder.all_trajectories(
        [
            {"spawn": world.spawn.name, "policy": policy.name, "seed": int(world.seed)}
            for world in worlds
        ]
    )
