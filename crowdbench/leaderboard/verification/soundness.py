"""Whether an entry can be one: its names, lists and numbers, before pages are made of them."""

import re

from crowdbench.errors import WeightsError
from crowdbench.leaderboard.submission.limits import MOST_FILES
from crowdbench.leaderboard.verification.curves import POINTS, TITLES
from crowdbench.leaderboard.verification.entry import Entry, check_numbers
from crowdbench.metrics import FAMILIES, METRICS
from crowdbench.scene import list_scenes
from crowdbench.trajectories.blocks import PARTS

FAMILY_OF = {metric.name: metric.family for metric in METRICS}
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


def check_entry(entry: Entry, where: object) -> None:
    """Refuse what no verification gives, whoever wrote it: a child, or somebody by hand.

    Raises:
        WeightsError: a name is none that crowdbench gives, a number is none, or lists that belong
            together do not fit.
    """
    check_numbers(entry, where)
    scenes = entry.scenes.values()
    curves = [c for s in scenes for c in s.curves.values()]
    for got, holds, expected in (
        (
            "an id or a scene of other letters",
            all(len(n) <= 60 and _NAME.fullmatch(n) for n in (entry.id, *entry.scenes)),
            "a-z, 0-9 and single hyphens, at most 60",
        ),
        ("an unknown family", all(set(s.families) <= set(FAMILIES) for s in scenes), "known ones"),
        ("an unknown metric", all(set(s.metrics) <= set(FAMILY_OF) for s in scenes), "known ones"),
        (
            "a scene that is none, or was not submitted",
            set(entry.scenes) <= {*list_scenes()} & {*entry.declared.scenes},
            "scenes of crowdbench that the submission declares",
        ),
        (
            "other flags than one of a kind and scene",
            len({(f.what, f.scene) for f in entry.flags}) == len(entry.flags)
            and {f.scene for f in entry.flags} <= set(entry.scenes),
            "each at most once, of a scene of the entry's",
        ),
        (
            "unknown parts",
            all(set(m.parts) <= set(PARTS) for s in scenes for m in s.metrics.values()),
            ", ".join(PARTS),
        ),
        (
            "unknown curves",
            all(set(s.curves) <= TITLES for s in scenes),
            ", ".join(sorted(TITLES)),
        ),
        (
            f"a curve of more than {POINTS} values",
            all(len(c.x) <= POINTS for c in curves),
            "fewer",
        ),
        (
            f"more than {MOST_FILES} artefacts",
            len(entry.artefacts) <= MOST_FILES,
            "those of one submission",
        ),
        (
            "a curve whose lines have other lengths than its axis",
            all(0 < len(c.x) == len(c.recorded) == len(c.simulated) for c in curves),
            "as many values, at least one",
        ),
    ):
        if not holds:
            hint = "Make it with `crowdbench leaderboard verify`."
            raise WeightsError(where, got=got, expected=expected, hint=hint)
