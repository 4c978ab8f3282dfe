"""What a policy remembers of each person, from its entry to the end of its trip."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.errors import SettingError

RANGES = {"memory": (0, 4096), "style": (0, 4096), "noise": (0, 4096), "interval": (1, 1000)}
"""Least and greatest values of what a policy asks for."""
_MEANING = {
    "memory": "the number of values that a policy remembers of a person",
    "style": "the number of random values of a person",
    "noise": "the number of random values of a decision",
    "interval": "the number of frames between two decisions",
}


@dataclass(eq=False)
class Memory:
    """What a policy remembers of the `A` persons who act, in the order of their observations."""

    state: Float32[np.ndarray, "A M"]
    """State of each person: zeros when it enters. The policy writes the next states here."""
    style: Float32[np.ndarray, "A S"]
    """Standard normal numbers, drawn when the person enters; the same for its whole trip."""
    world: Int[np.ndarray, " A"]
    """World of each person. Only a policy with `many_worlds` sees several worlds in a rollout."""
    person: Int[np.ndarray, " A"]
    """Id of each person in its world."""
    entered: Bool[np.ndarray, " A"]
    """Whether the policy sees the person for the first time."""
    noise: Float32[np.ndarray, "_ Z"] = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """Standard normal numbers (A, Z), drawn for each decision; of size 0 if there are none."""


@dataclass(frozen=True)
class Needs:
    """What a policy asks for, by its attributes `memory`, `style`, `noise` and `interval`."""

    memory: int = 0
    """Size M of the state of a person."""
    style: int = 0
    """Number S of random numbers of a person."""
    noise: int = 0
    """Number Z of random numbers of a decision."""
    interval: int = 1
    """Number of frames between two decisions; the velocity is kept in between."""

    @classmethod
    def of(cls, policy: object) -> "Needs":
        """The needs of a policy.

        Raises:
            SettingError: an attribute is not a whole number in its range.
        """
        found = {name: getattr(policy, name, least) for name, (least, _) in RANGES.items()}
        for name, value in found.items():
            least, most = RANGES[name]
            if not isinstance(value, int | np.integer) or not least <= value <= most:
                raise SettingError(
                    f"policy {getattr(policy, 'name', '')}",
                    got=f"{name} = {value!r}",
                    expected=f"a whole number from {least} to {most}",
                    hint=f"`{name}` is {_MEANING[name]}. Rename the attribute if it means "
                    "something else.",
                )
        return cls(**found)

    @property
    def memories(self) -> bool:
        """Whether `act` is called with a `Memory`."""
        return self.memory > 0 or self.style > 0 or self.noise > 0
