"""`Actor`: a policy that moves the people of a simulation; what it sees, and remembers of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int
from numpy.random import Generator

from crowdbench.errors import ActionError, SettingError
from crowdbench.policies import Policy, StateView
from crowdbench.policies.memory import Memory, Needs
from crowdbench.simulation import Settings, Shown, Simulation
from crowdbench.simulation.observations import version_of
from crowdbench.simulation.social import in_own_frame


def needs(policy: Policy) -> dict[str, Any]:
    """What a policy needs to see: those of the fields of `Shown` that it has as attributes.

    A policy with the attribute `observation` but none for its rays needs the default rays. Empty
    for a policy that sees the state, and for one that takes any observation.

    Raises:
        SettingError: there is no such observation.
    """
    if policy.sees == "state":
        return {}
    named = {name: getattr(policy, name, None) for name in Shown._fields}
    found = {name: value for name, value in named.items() if value is not None}
    if "observation" not in found:
        return found
    if not version_of(found["observation"]).rays:
        return {"observation": found["observation"]}
    return Shown()._asdict() | found


def settings_for(
    policy: Policy, settings: Settings | None = None, *, hint: str | None = None
) -> Settings:
    """Settings of a simulation whose observation is the one that a policy needs.

    What the policy does not say is that of `settings`, whose `max_alive` is 4096 if it is None.
    `hint` replaces the hint of the error, and may contain `{name}` and `{value!r}`.

    Raises:
        SettingError: `settings` contain a value that contradicts the policy, or there is no such
            observation.
    """
    settings = Settings(max_alive=4096) if settings is None else settings
    if policy.sees == "state":
        return settings
    needed = needs(policy)
    filled = replace(settings, **settings.shown._replace(**needed)._asdict())
    for name, value in needed.items():
        chosen = getattr(settings, name)
        applies = name == "observation" or filled.shown.version.rays
        if chosen is not None and chosen != value and applies:
            hint = hint or "Set {name}={value!r}, or leave it out of the settings."
            raise SettingError(
                f"policy {policy.name}",
                got=f"{name} = {chosen!r} in the settings",
                expected=f"{name} = {value!r}, which the policy needs",
                hint=hint.format(name=name, value=value),
            )
    return filled


class Actor:
    """Calls a policy for the people of a simulation and keeps its memory of each of them.

    A person's memory begins when the policy sees the person for the first time, and is forgotten
    with the next person in its slot. A policy with a decision interval of k frames decides for a
    person when it sees it first and then in each k-th frame of its trip.
    """

    def __init__(self, policy: Policy, simulation: Simulation) -> None:
        """An actor that has seen nobody.

        Raises:
            SettingError: the policy's `memory`, `style` or `interval` is out of range, or the
                simulation shows another observation than the policy needs.
        """
        settings = simulation.settings
        settings_for(policy, replace(settings, **settings.shown._asdict()))  # checks what is shown
        self.policy = policy
        self._simulation = simulation
        self._needs = Needs.of(policy)
        self._rngs: tuple[Generator, ...] = ()
        size = simulation.slots.alive.size if self._keeps else 0
        self._state = np.zeros((size, self._needs.memory), np.float32)
        self._style = np.zeros((size, self._needs.style), np.float32)
        self._held = np.zeros((size, 2), np.float32)
        self._event = np.full(size, -1, np.int32)

    @property
    def _keeps(self) -> bool:
        return self._needs.memories or self._needs.interval > 1

    def reset(self, *rngs: Generator) -> None:
        """Let the policy draw from one generator, or from one per world, from now on.

        People who are present are remembered.
        """
        self.policy.reset(self._simulation.scene, rngs[0])
        self._rngs = rngs

    def begin_anew(self, worlds: Int[np.ndarray, " n"], rngs: Sequence[Generator]) -> None:
        """Forget the people of some worlds, for whom it draws from new generators from now on.

        There is one generator per world.
        """
        mine = list(self._rngs)
        for world, rng in zip(worlds.tolist(), rngs, strict=True):
            mine[world] = rng
        self._rngs = tuple(mine)
        if self._keeps:
            self._event.reshape(self._simulation.slots.alive.shape)[worlds] = -1

    def copy_worlds(self, mine: Int[np.ndarray, " n"], theirs: Int[np.ndarray, " n"]) -> None:
        """Remember in the worlds `mine` what is remembered in the worlds `theirs`.

        Their generators go on from the same state, too.
        """
        for world, of_world in zip(mine.tolist(), theirs.tolist(), strict=True):
            state = self._rngs[of_world].bit_generator.state
            self._rngs[world].bit_generator.state = state
        shape = self._simulation.slots.alive.shape
        for of in (self._state, self._style, self._held, self._event):
            if of.size:
                by_world = of.reshape(*shape, *of.shape[1:])
                by_world[mine] = by_world[theirs]

    def hand_over(self, policy: Policy) -> None:
        """Let another policy act from now on, which has the same needs and sees the same."""
        self.policy = policy

    @property
    def world_frame(self) -> bool:
        """Whether the actions are in the world frame, and not in that of the observation."""
        return self.policy.sees == "state"

    @property
    def own_frame(self) -> bool:
        """Whether the actions are in the own frames of the people."""
        return not self.world_frame and self._simulation.settings.own_frame

    def step(self) -> None:
        """Advance every world by one frame in which the policy moves everyone.

        Raises:
            ActionError: see `actions`.
        """
        self._simulation.step(self.actions(), own_frame=self.own_frame)

    def actions(self, who: Bool[np.ndarray, "W N"] | None = None) -> Float32[np.ndarray, "W N 2"]:
        """Actions for everyone present, or for those of them in `who`; zeros elsewhere.

        A policy that sees the state sees everyone in either case, and its actions are in the world
        frame. Those of other policies are in the frame of the simulation's observation.

        Raises:
            ActionError: the policy does not return one finite action per person, or writes states
                that are not finite.
        """
        policy, simulation = self.policy, self._simulation
        act: Any = policy.act  # of one of three protocols, as `sees` and the needs tell
        there = simulation.slots.alive
        actions = np.zeros(simulation.slots.position.shape, np.float32)
        who = there if who is None else there & who
        if not who.any():  # some policies cannot handle empty arrays
            return actions
        flat = actions.reshape(-1, 2)
        if policy.sees == "state":
            view = StateView.of(simulation)
            at = view.world * there.shape[1] + view.slot
            flat[at] = checked_actions(act(view), len(view.slot), policy)
            if who is not there:
                actions[there & ~who] = 0
            return actions
        at = np.flatnonzero(who)  # indexing by one index array is faster than by a mask
        observation = simulation.observe()
        seen = observation.reshape(-1, observation.shape[-1])
        if not self._keeps:
            flat[at] = checked_actions(act(seen.take(at, axis=0)), len(at), policy)
            return actions
        event = simulation.slots.event.ravel()
        entered = self._event[at] != event[at]
        new = at[entered]
        self._event[new] = event[new]
        self._state[new] = 0.0
        self._style[new] = self._drawn(new, self._needs.style)
        due = self._due(at) | entered
        deciding, others = at[due], at[~due]
        if len(deciding):
            flat[deciding] = self._decided(seen.take(deciding, axis=0), deciding, entered[due])
        if self._needs.interval > 1:
            # People keep their velocities; their headings may have changed meanwhile.
            flat[others] = self._turned(self._held[others], others)
            self._held[deciding] = self._turned(flat[deciding], deciding, back=True)
        return actions

    def _drawn(self, at: Int[np.ndarray, " n"], width: int) -> Float32[np.ndarray, "n _"]:
        """Standard normal numbers of persons, drawn from the generators of their worlds."""
        if width == 0:
            return np.empty((len(at), 0), np.float32)
        if len(self._rngs) == 1:
            return self._rngs[0].standard_normal((len(at), width), dtype=np.float32)
        persons = np.bincount(
            at // self._simulation.slots.alive.shape[1], minlength=len(self._rngs)
        )
        return np.concatenate(
            [
                rng.standard_normal((n, width), dtype=np.float32)
                for rng, n in zip(self._rngs, persons.tolist(), strict=True)
            ]
        )

    def _turned(
        self, action: Float32[np.ndarray, "n 2"], at: Int[np.ndarray, " n"], *, back: bool = False
    ) -> Float32[np.ndarray, "n 2"]:
        """Actions of the world frame in that of the simulation, or `back` in the world frame."""
        if not self._simulation.settings.own_frame:
            return action
        heading = self._simulation.slots.heading.reshape(-1, 2)[at]
        return in_own_frame(action, heading * np.array([1, -1]) if back else heading)

    def _due(self, at: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        simulation = self._simulation
        world = at // simulation.slots.alive.shape[1]
        age = simulation.clock.frame[world] - simulation.slots.born.ravel()[at]
        return np.asarray(age % self._needs.interval == 0)

    def _decided(
        self,
        seen: Float32[np.ndarray, "n obs"],
        at: Int[np.ndarray, " n"],
        entered: Bool[np.ndarray, " n"],
    ) -> Float32[np.ndarray, "n 2"]:
        policy = self.policy
        act: Any = policy.act
        if not self._needs.memories:
            return checked_actions(act(seen), len(seen), policy)
        memory = Memory(
            state=self._state[at],
            style=self._style[at],
            noise=self._drawn(at, self._needs.noise),
            world=at // self._simulation.slots.alive.shape[1],
            person=self._simulation.slots.person.ravel()[at],
            entered=entered,
        )
        found = checked_actions(act(seen, memory), len(seen), policy)
        self._state[at] = checked_states(memory, len(at), self._needs.memory, policy)
        return found


def checked_states(
    memory: Memory, persons: int, size: int, policy: Policy
) -> Float32[np.ndarray, "A M"]:
    """The next states that a policy wrote.

    Raises:
        ActionError: they are not finite numbers of shape (`persons`, `size`).
    """
    state = np.asarray(memory.state)
    got = ""
    if state.shape != (persons, size):
        got = f"next states of shape {state.shape}"
    elif not np.isfinite(state).all():
        got = f"{int((~np.isfinite(state)).sum())} values of next states that are not finite"
    if got:
        raise ActionError(
            f"policy {policy.name}",
            got=got,
            expected=f"finite numbers of shape ({persons}, {size}) in memory.state",
            hint="Write into the array: memory.state[:] = …",
        )
    return state.astype(np.float32, copy=False)


def checked_actions(actions: object, persons: int, policy: Policy) -> Float32[np.ndarray, "A 2"]:
    """The actions of a policy, clipped to [−1, 1].

    Raises:
        ActionError: they are not one finite pair of numbers per person.
    """
    got = np.asarray(actions)
    if got.shape != (persons, 2) or got.dtype.kind not in "fiu":
        raise ActionError(
            f"policy {policy.name}",
            got=f"an array of shape {got.shape} and type {got.dtype} from act",
            expected=f"one action for each of {persons} persons, numbers of shape ({persons}, 2)",
        )
    if not np.isfinite(got).all():
        raise ActionError(
            f"policy {policy.name}",
            got=f"{int((~np.isfinite(got)).sum())} values from act that are not finite",
            expected="finite numbers",
            hint="Check the policy for a division by zero or a diverged network.",
        )
    return got.clip(-1, 1).astype(np.float32, copy=False)
