"""Check the names, lists and numbers of an entry before pages are built from it."""

import re

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import WeightsError
from crowdbench.leaderboard.submission.limits import MOST_FILES
from crowdbench.leaderboard.verification.curves import POINTS, TITLES
from crowdbench.leaderboard.verification.entry import Entry, check_numbers
from crowdbench.metrics import FAMILIES, METRICS
from crowdbench.scene import list_scenes

FAMILY_OF = {metric.name: metric.family for metric in METRICS}
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


def check_entry(entry: Entry, where: object) -> None:
    """Reject an entry that verification cannot have written.

    Entries may come from an untrusted child process or be edited by hand.

    Raises:
        WeightsError: a name is unknown, a number is invalid, or lists do not match each other.
    """
    check_numbers(entry, where)
    scenes = entry.scenes.values()
    curves = [c for s in scenes for c in s.curves.values()]
    for got, holds, expected in (
        (
            "an invalid id or scene name",
            all(len(n) <= 60 and _NAME.fullmatch(n) for n in (entry.id, *entry.scenes)),
            "a-z, 0-9 and single hyphens, at most 60 characters",
        ),
        (
            "an unknown family",
            all(set(s.families) <= set(FAMILIES) for s in scenes),
            "families of crowdbench",
        ),
        (
            "an unknown metric",
            all(set(s.metrics) <= set(FAMILY_OF) for s in scenes),
            "metrics of crowdbench",
        ),
        (
            "a scene that is unknown or was not submitted",
            set(entry.scenes) <= {*list_scenes()} & {*entry.declared.scenes},
            "scenes of crowdbench that the submission declares",
        ),
        (
            "repeated flags, or flags of other scenes",
            len({(f.what, f.scene) for f in entry.flags}) == len(entry.flags)
            and {f.scene for f in entry.flags} <= set(entry.scenes),
            "each flag at most once for each scene of the entry",
        ),
        (
            "unknown splits",
            all(set(m.splits) <= set(SPLITS) for s in scenes for m in s.metrics.values()),
            ", ".join(SPLITS),
        ),
        (
            "unknown curves",
            all(set(s.curves) <= TITLES for s in scenes),
            ", ".join(sorted(TITLES)),
        ),
        (
            f"a curve of more than {POINTS} values",
            all(len(c.x) <= POINTS for c in curves),
            f"at most {POINTS}",
        ),
        (
            f"more than {MOST_FILES} artefacts",
            len(entry.artefacts) <= MOST_FILES,
            f"at most {MOST_FILES}",
        ),
        (
            "a curve that is empty, or whose lines do not have the length of its axis",
            all(0 < len(c.x) == len(c.recorded) == len(c.simulated) for c in curves),
            "lines and an axis of equal length",
        ),
    ):
        if not holds:
            hint = "Create it with `crowdbench leaderboard verify`."
            raise WeightsError(where, got=got, expected=expected, hint=hint)
