"""The people whom an environment controls, one at a time in each of its places, and all others.

It is what `CrowdVecEnv` and `PersonEnv` have in common: who is controlled, who walks by a policy,
and whose trip has ended. All physics is in `Simulation`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int, Int8

from crowdbench.envs.config import EnvCrowd
from crowdbench.errors import ActionError
from crowdbench.policies import Policy
from crowdbench.run.acting import Actor, needs
from crowdbench.run.episode import generator


class Step(NamedTuple):
    """What a step was to the `n` places; zeros in places where nobody was controlled."""

    acting: Bool[np.ndarray, " n"]
    """Whether the place had a person."""
    person: Int[np.ndarray, " n"]
    """Ids of the persons, −1 without one."""
    parts: Float32[np.ndarray, "n parts"]
    """Parts of the rewards."""
    ended: Int8[np.ndarray, " n"]
    """Outcomes of the trips that ended, as indices into `OUTCOMES`; 0 for none."""
    seen: Float32[np.ndarray, "n obs"]
    """Observations after the step, of trips that ended their last ones."""


class ControlledPeople:
    """Up to `n` people in the worlds of a crowd who are controlled from outside."""

    def __init__(self, crowd: EnvCrowd, n: int) -> None:
        """`n` places, in which nobody is controlled yet."""
        self._crowd, self._simulation = crowd, crowd.simulation
        self.at = np.zeros((2, n), np.int64)
        """World and slot of the person of each place."""
        self.free = np.ones(n, bool)
        """Whether nobody is controlled in a place."""
        self._taken = np.zeros(self._simulation.slots.alive.shape, bool)

    @property
    def person_id(self) -> Int[np.ndarray, " n"]:
        """Id of each place's person within its world; −1 without one."""
        ids = self._simulation.slots.person[*self.at].astype(np.int64)
        return np.where(self.free, -1, ids)

    @property
    def over(self) -> bool:
        """Whether the episode of the crowd has reached its horizon."""
        return bool(self._simulation.clock.frame[0] >= self._crowd.frames)

    def begin(self, seed: int, others: Policy) -> None:
        """Begin an episode in all worlds, in which nobody is controlled and `others` walk.

        Raises:
            CapacityError: there are more people than `max_alive`, unless `on_full` is `drop`.
        """
        simulation = self._simulation
        self._crowd.begin(seed)
        self._crowd.check_capacity()
        shown = simulation.settings.shown
        theirs = shown._replace(**needs(others))
        self._actor = Actor(others, simulation if theirs == shown else simulation.showing(theirs))
        self._actor.reset(generator(seed, 0, "policy"))
        simulation.observe()
        self._crowd.follow()
        self.free[:] = True
        self._taken[:] = False

    def step(self, actions: Float32[np.ndarray, "n 2"]) -> Step:
        """Advance all worlds by one frame. People whose trips end are no longer controlled.

        Raises:
            CapacityError: there are more people than `max_alive`, unless `on_full` is `drop`.
        """
        simulation, acting = self._simulation, ~self.free
        at = tuple(self.at[:, acting])
        commands = self._actor.actions(~self._taken)
        commands[at] = actions[acting]
        own_frame = simulation.settings.own_frame  # of the observations of those controlled
        simulation.step(commands, own_frame=np.where(self._taken, own_frame, self._actor.own_frame))
        self._crowd.check_capacity()
        simulation.observe()
        self._crowd.follow()
        of_all = self._crowd.reward_parts()
        parts = np.zeros((len(acting), of_all.shape[-1]), np.float32)
        parts[acting] = of_all[at]
        ended = np.zeros(len(acting), np.int8)
        ended[acting] = simulation.slots.ended[at]
        made = Step(acting, self.person_id, parts, ended, self.observations())
        self.release(ended != 0)
        return made

    def release(self, places: Bool[np.ndarray, " n"]) -> None:
        """Leave the people of these places to the policy."""
        self._taken[tuple(self.at[:, places])] = False
        self.free |= places

    def take(self, world: Int[np.ndarray, " k"], slot: Int[np.ndarray, " k"]) -> None:
        """Control people in the first free places, as far as there are any."""
        places = np.flatnonzero(self.free)[: len(world)]
        world, slot = world[: len(places)], slot[: len(places)]
        self.at[:, places] = world, slot
        self._taken[world, slot] = True
        self.free[places] = False

    def take_newest(self) -> None:
        """Control the people who entered last of those who are not controlled."""
        if self.free.any():
            slots = self._simulation.slots
            w, i = np.nonzero(slots.alive & ~self._taken)
            newest = np.argsort(-slots.born[w, i], kind="stable")
            self.take(w[newest], i[newest])

    def observations(self) -> Float32[np.ndarray, "n obs"]:
        """What each place's person sees; zeros without one."""
        seen: np.ndarray = self._simulation.observation[*self.at]
        seen[self.free] = 0
        return seen


def checked_actions(where: str, actions: object, n: int) -> Float32[np.ndarray, "n 2"]:
    """The actions of `n` people.

    Raises:
        ActionError: they have another shape or are not finite; `where` names the method.
    """
    try:
        with np.errstate(over="ignore"):
            given = np.asarray(actions, np.float32)
    except (TypeError, ValueError):
        expected = f"finite numbers of shape ({n}, 2)"
        raise ActionError(where, got="other than numbers", expected=expected) from None
    if given.shape != (n, 2) or not np.isfinite(given).all():
        raise ActionError(
            where,
            got=f"an array of shape {given.shape}"
            if given.shape != (n, 2)
            else f"{int((~np.isfinite(given)).sum())} values that are not finite",
            expected=f"finite numbers of shape ({n}, 2)",
        )
    return given
