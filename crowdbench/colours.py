"""Colours shared by pictures, pages and the viewer."""

from collections.abc import Sequence
from itertools import cycle

# Okabe & Ito's palette, which colour-blind readers can distinguish. The recording is black.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
SPAWN_COLOURS = dict(zip(("poisson-gmm", "renewal-gmm", "ntpp-gmm"), COLOURS, strict=False))
"""Fixed colours of the spawn models that the results pages compare."""


def goal_colour(area: int) -> str:
    """Colour (`#RRGGBB`) of a goal area and of everyone who walks to it."""
    return COLOURS[area % len(COLOURS)]


def spawn_colours(spawns: Sequence[str]) -> dict[str, str]:
    """Colour of each spawn model: from `SPAWN_COLOURS`, else the remaining colours in turn."""
    others = [spawn for spawn in dict.fromkeys(spawns) if spawn not in SPAWN_COLOURS]
    free = COLOURS[len(SPAWN_COLOURS) :]
    return SPAWN_COLOURS | dict(zip(others, cycle(free), strict=False))
