"""The card of a policy's file: what it sees, and what it was trained on."""

import re

import msgspec

from crowdbench.errors import WeightsError
from crowdbench.simulation.observations import known_observations, size_of
from crowdbench.trajectories.blocks import PARTS

SCHEMA = 1
ACTION = "velocity-1"
"""Version of the action: a velocity in units of the scene's greatest speed, in [−1, 1]²."""
HINT = "Export it anew with `crowdbench policy export`."
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,39}")


class PolicyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a policy's file says of it."""

    schema: int = SCHEMA
    name: str
    """Under which tables show it."""
    observation: str
    """Version of what it sees, see `crowdbench.simulation.observations`."""
    rays: int = 32
    ray_range_m: float = 10.0
    action: str = ACTION
    scene: str
    """Id of the scene it was trained on."""
    part: str
    """One of `blocks.PARTS`: what of the recording it was trained on."""
    command: str = ""
    """What trained it."""
    revision: str = ""
    """Git revision of the code that did."""

    @property
    def inputs(self) -> int:
        """Numbers in an observation."""
        return size_of(self.observation, self.rays)

    def checked(self, where: object) -> "PolicyCard":
        """The card, if what it says can be.

        Raises:
            WeightsError: it is of another version, or a value is out of range.
        """
        problems = (
            ("schema", self.schema, self.schema == SCHEMA, str(SCHEMA)),
            ("name", self.name, _NAME.fullmatch(self.name), "1 to 40 letters, digits, or ' ._+-'"),
            (
                "observation",
                self.observation,
                self.observation in known_observations(),
                f"one of {', '.join(known_observations())}",
            ),
            ("rays", self.rays, 1 <= self.rays <= 1024, "1 to 1024"),
            ("ray_range_m", self.ray_range_m, 0 < self.ray_range_m <= 1000, "metres up to 1000"),
            ("action", self.action, self.action == ACTION, ACTION),
            ("part", self.part, self.part in PARTS, " or ".join(PARTS)),
            ("scene", self.scene, _NAME.fullmatch(self.scene), "the id of a scene"),
            ("command", "", _plain(self.command), "plain text of up to 1000 characters"),
            ("revision", "", _plain(self.revision), "plain text of up to 1000 characters"),
        )
        for name, got, fits, expected in problems:
            if not fits:
                raise WeightsError(
                    where, got=f"the {name} {got!r}"[:200], expected=expected, hint=HINT
                )
        return self


def _plain(text: str) -> bool:
    return len(text) <= 1000 and all(c.isprintable() for c in text)
