"""Recorded people who are moved by a policy, but stay near their recorded paths.

In each decision the policy draws several actions for each person, and the person walks the one that
ends nearest to its recorded next position. The states that a policy visits by itself can thus be
labelled with what the recorded person did (after Zhang et al. 2025, Closed-Loop Supervised
Fine-Tuning of Tokenized Traffic Models, CVPR, arXiv:2412.05334).
"""

from typing import Any

import numpy as np
from jaxtyping import Float32, Int
from numpy.random import Generator

from crowdbench.envs.recorded_paths import RecordedContinuation
from crowdbench.policies import Memory, Policy, StateView
from crowdbench.policies.memory import Needs
from crowdbench.run.acting import checked_actions, checked_states
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.social import in_own_frame

FAR_M = 3.0
"""People who are farther than this from their recorded positions are led back to them."""


class NearestCandidate:
    """The policy that walks the best of several actions of another policy.

    The other policy is called once for all candidates: each person is in `candidates` rows of the
    batch, with the same observation, state and style. The person's next state is that of the action
    that it walks.
    """

    def __init__(
        self,
        policy: Policy,
        candidates: int,
        simulation: Simulation,
        continuation: RecordedContinuation,
    ) -> None:
        """Raises SettingError: the policy's `memory`, `style` or `interval` is out of range."""
        self.policy = policy
        self.name, self.sees = policy.name, policy.sees
        # The candidates of a policy without random draws are all the same.
        self.candidates = 1 if getattr(policy, "deterministic", False) else candidates
        self._needs = Needs.of(policy)
        # At least 1, because only policies with a memory are told who decides.
        self.memory = max(1, self._needs.memory)
        self.style, self.interval = self._needs.style, self._needs.interval
        self.noise = self.candidates * self._needs.noise
        self._simulation, self._continuation = simulation, continuation

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode in which the policy draws from `rng`."""
        self.policy.reset(scene, rng)

    def act(
        self, seen: Float32[np.ndarray, "A obs"] | StateView, memory: Memory | None = None
    ) -> Float32[np.ndarray, "A 2"]:
        """The actions that are walked; the next states that belong to them go to `memory`.

        Raises:
            ActionError: the policy does not return one finite action per row, or writes states that
                are not finite.
        """
        if isinstance(seen, StateView):
            act: Any = self.policy.act
            drawn = [
                checked_actions(act(seen), len(seen.slot), self.policy)
                for _ in range(self.candidates)
            ]
            return self._nearest(np.stack(drawn), seen.slot, own_frame=False)[0]
        assert memory is not None  # its size is at least 1
        actions, states = self._drawn(seen, memory)
        slots = self._simulation.slots
        there = np.flatnonzero(slots.alive[0])
        by_person = there[np.argsort(slots.person[0, there])]
        slot = by_person[np.searchsorted(slots.person[0, by_person], memory.person)]
        own_frame = self._simulation.settings.own_frame
        walked, best = self._nearest(actions, slot, own_frame=own_frame)
        memory.state[:, : self._needs.memory] = states[best, np.arange(len(best))]
        return walked

    def _drawn(
        self, seen: Float32[np.ndarray, "A obs"], memory: Memory
    ) -> tuple[Float32[np.ndarray, "C A 2"], Float32[np.ndarray, "C A M"]]:
        """Actions and next states of all candidates."""
        count, persons = self.candidates, len(seen)
        act: Any = self.policy.act
        rows = np.tile(seen, (count, 1))
        states = np.zeros((count * persons, self._needs.memory), np.float32)
        if self._needs.memories:
            each = Memory(
                state=np.tile(memory.state[:, : self._needs.memory], (count, 1)),
                style=np.tile(memory.style, (count, 1)),
                noise=_by_candidate(memory.noise, count),
                world=np.tile(memory.world, count),
                person=np.tile(memory.person, count),
                entered=np.tile(memory.entered, count),
            )
            actions = checked_actions(act(rows, each), len(rows), self.policy)
            states = checked_states(each, len(rows), self._needs.memory, self.policy)
        else:
            actions = checked_actions(act(rows), len(rows), self.policy)
        shape = (count, persons)
        return actions.reshape(*shape, 2), states.reshape(*shape, self._needs.memory)

    def _nearest(
        self, actions: Float32[np.ndarray, "C A 2"], slot: Int[np.ndarray, " A"], *, own_frame: bool
    ) -> tuple[Float32[np.ndarray, "A 2"], Int[np.ndarray, " A"]]:
        """The action of each person that ends nearest to its recorded position, and its index.

        Walls are not considered. People who are too far away walk straight to that position.
        """
        slots, frame = self._simulation.slots, int(self._simulation.clock.frame[0])
        person, position = slots.event[0, slot], slots.position[0, slot]
        back = self._continuation.action(person, frame, position)
        heading = np.where(own_frame, slots.heading[0, slot], [1.0, 0.0])
        x, y, cos, sin = *back.T, *heading.T
        wanted = np.stack([x * cos + y * sin, y * cos - x * sin], axis=1)  # beyond [−1, 1], too
        speed = np.hypot(actions[..., 0], actions[..., 1])
        off = actions / np.maximum(1, speed)[..., None] - wanted  # as a step clips them
        best = (off * off).sum(axis=2).argmin(axis=0)
        walked = actions[best, np.arange(len(slot))]
        far = self._continuation.deviation_m(person, frame, position) > FAR_M
        walked[far] = in_own_frame(back, heading)[far]
        return walked, best


def _by_candidate(
    noise: Float32[np.ndarray, "A CZ"], candidates: int
) -> Float32[np.ndarray, "CA Z"]:
    """Random numbers of all candidates, in the order of the batch: candidate, then person."""
    persons = len(noise)
    each = noise.reshape(persons, candidates, -1).swapaxes(0, 1)
    return np.ascontiguousarray(each).reshape(candidates * persons, -1)
