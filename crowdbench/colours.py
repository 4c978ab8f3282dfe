"""The colours of pictures, pages and the viewer."""

from collections.abc import Sequence
from itertools import cycle

# Okabe & Ito's colours, which colour-blind readers can tell apart; the recording is black.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
SPAWN_COLOURS = dict(zip(("poisson-gmm", "renewal-gmm", "ntpp-gmm"), COLOURS, strict=False))
"""Colours of the spawn models that pages of results compare: the same in every picture."""


def goal_colour(area: int) -> str:
    """The colour of a goal area and of all who walk there, `#RRGGBB`."""
    return COLOURS[area % len(COLOURS)]


def spawn_colours(spawns: Sequence[str]) -> dict[str, str]:
    """Colours of spawn models: those of `SPAWN_COLOURS`, then the free ones in turn."""
    others = [spawn for spawn in dict.fromkeys(spawns) if spawn not in SPAWN_COLOURS]
    free = COLOURS[len(SPAWN_COLOURS) :]
    return SPAWN_COLOURS | dict(zip(others, cycle(free), strict=False))
