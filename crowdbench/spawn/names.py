"""Names of the spawn models that let recorded people enter."""

import re

PERTURBED = "perturbed-replay"


def replays(spawn: str) -> bool:
    """Whether a spawn model of this name lets recorded people enter, with or without changes.

    Then policies alone are judged, on motion and interaction.
    """
    return spawn == "replay" or with_key(spawn) is not None


def with_key(spawn: str) -> str | None:
    """The key in the name `perturbed-replay:KEY`, empty without one; None for other models."""
    found = re.fullmatch(rf"{PERTURBED}(?::(\w+))?", spawn)
    return None if found is None else found[1] or ""
