"""The card of a policy file: metadata on its observation and training data."""

import math
import re

import msgspec

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.policies.memory import RANGES
from crowdbench.simulation.observations import known_observations, size_of, version_of

SCHEMA = 1
ACTION = "velocity-1"
"""Version of the action: a velocity in units of the scene's maximum speed, in [−1, 1]², in the
frame of the observation."""
HINT = "Export the network again with `crowdbench policy export`."
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,39}")
_RANGES = {name: RANGES[name] for name in ("memory", "style", "interval")} | {
    "rays": (1, 1024),
    "ray_range_m": (0.1, 1000.0),
}


class PolicyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Metadata of a policy file."""

    schema: int = SCHEMA
    name: str
    """Name of the policy in tables."""
    observation: str
    """Version of the observation, see `crowdbench.simulation.observations`."""
    rays: int = 32
    """Number of rays of an observation; does not apply to `social-1`."""
    ray_range_m: float = 10.0
    """Range of the rays in metres."""
    memory: int = 0
    """Size of the state that the network keeps of a person; 0: it remembers nobody."""
    style: int = 0
    """Number of random numbers that are drawn once per person."""
    interval: int = 1
    """Number of frames between two decisions for a person."""
    action: str = ACTION
    """Version of the action."""
    max_speed_mps: float | None = None
    """Unit of its velocities, if they are to be converted on scenes with another maximum speed;
    only with the observation `social-1`."""
    scene: str
    """Id of the scene it was trained on; of several, their ids joined by `+`."""
    split: str
    """Split of the recording it was trained on, one of `blocks.SPLITS`."""
    command: str = ""
    """Command that trained it."""
    revision: str = ""
    """Git revision of the training code."""

    @property
    def scenes(self) -> tuple[str, ...]:
        """Ids of the scenes it was trained on."""
        return tuple(self.scene.split("+"))

    @property
    def trained_on(self) -> str:
        """The split and the scenes it was trained on, for messages."""
        return f"{self.split} of {', '.join(self.scenes)}"

    @property
    def inputs(self) -> int:
        """Number of values in an observation."""
        return size_of(self.observation, self.rays)

    def input_sizes(self, noise: int) -> dict[str, int]:
        """Size of each input of its network, in their order, with `noise` random numbers."""
        sizes = {"noise": noise, "state": self.memory, "style": self.style}
        return {"observation": self.inputs} | {name: size for name, size in sizes.items() if size}

    @property
    def output_sizes(self) -> dict[str, int]:
        """Size of each output of its network, in their order."""
        return {"action": 2} | ({"next_state": self.memory} if self.memory else {})

    @property
    def with_rays(self) -> str:
        """Words on the rays for messages, ` with 32 rays`; empty if the observation has none."""
        return f" with {self.rays} rays" if version_of(self.observation).rays else ""

    def check_width(self, width: int) -> None:
        """Check the number of values in an observation.

        Raises:
            SettingError: the policy needs another observation.
        """
        if width != self.inputs:
            rays = f", rays={self.rays}, ray_range_m={self.ray_range_m:g}" * bool(self.with_rays)
            got = f"observations of {width} numbers"
            expected = f"the {self.inputs} numbers of {self.observation}{self.with_rays}"
            hint = f"Make the environment with observation={self.observation!r}{rays}."
            raise SettingError(f"policy {self.name}", got=got, expected=expected, hint=hint)

    def checked(self, where: object) -> "PolicyCard":
        """This card, after validation; `where` is named in error messages.

        Raises:
            WeightsError: the card has another version, or a value is out of range.
        """
        chosen = (("observation", known_observations()), ("action", (ACTION,)), ("split", SPLITS))
        own_unit = self.max_speed_mps is None or (
            0 < self.max_speed_mps < math.inf and self.observation == "social-1"
        )
        rules = (
            ("schema", self.schema == SCHEMA, str(SCHEMA)),
            ("name", _NAME.fullmatch(self.name), "1 to 40 letters, digits, or ' ._+-'"),
            *(
                (name, low <= getattr(self, name) <= high, f"{low:g} to {high:g}")
                for name, (low, high) in _RANGES.items()
            ),
            *((name, getattr(self, name) in of, f"one of {', '.join(of)}") for name, of in chosen),
            ("max_speed_mps", own_unit, "a positive number, only with social-1"),
            ("scene", all(map(_NAME.fullmatch, self.scenes)), "the id of a scene"),
            ("command", _plain(self.command), "plain text of up to 1000 characters"),
            ("revision", _plain(self.revision), "plain text of up to 1000 characters"),
        )
        for name, fits, expected in rules:
            if not fits:
                got = f"the {name} {getattr(self, name)!r}"[:200]
                raise WeightsError(where, got=got, expected=expected, hint=HINT)
        return self


def _plain(text: str) -> bool:
    return len(text) <= 1000 and all(c.isprintable() for c in text)
