"""Check the names and lists of an entry before it is shown."""

import numpy as np

from crowdbench.errors import WeightsError
from crowdbench.leaderboard.submission.errors import plain
from crowdbench.leaderboard.verification.curves import TITLES
from crowdbench.leaderboard.verification.entry import HINT, LARGEST, Entry
from crowdbench.metrics import FAMILIES, METRICS, WALK
from crowdbench.scene import list_scenes

FAMILY_OF = {metric.name: metric.family for metric in METRICS}


def check_entry(entry: Entry, where: object) -> None:
    """Reject an entry that verification cannot have written.

    Entries may come from an untrusted child process or be edited by hand.

    Raises:
        WeightsError: a name is unknown, a resample is invalid, or lists do not match each other.
    """
    scenes = entry.scenes.values()
    recorded = [s.as_recorded for s in scenes if s.as_recorded is not None]
    submitted = {*list_scenes()} & {*entry.declared.scenes}
    for what, names, known in (
        ("scene", entry.scenes.keys(), submitted),
        ("scene of a flag", {flag.scene for flag in entry.flags}, entry.scenes),
        ("scene of an exam", set() if entry.exam is None else {entry.exam.scene}, entry.scenes),
        ("family", {name for s in scenes for name in s.families}, FAMILIES),
        ("family as recorded", {name for of in recorded for name in of.families}, WALK),
        ("metric", {name for s in scenes for name in s.metrics}, FAMILY_OF),
        ("curve", {name for s in scenes for name in s.curves}, TITLES),
    ):
        if unknown := sorted(names - set(known)):
            got = f"an unknown {what}, {plain(ascii(unknown[0]), 80)}"
            expected = f"one of {', '.join(sorted(known))}"
            raise WeightsError(where, got=got, expected=expected, hint=HINT)
    families = [*(s.families for s in scenes), *(of.families for of in recorded)]
    cards = [card for each in families for card in each.values()]
    lines = [(c.x, c.recorded, c.simulated) for scene in scenes for c in scene.curves.values()]
    tests = [] if entry.exam is None else [*entry.exam.passed, *entry.exam.failed]
    for got, holds, expected in (
        ("repeated tests of an exam", len({*tests}) == len(tests), "each test once"),
        (
            "repeated flags",
            len({(flag.what, flag.scene) for flag in entry.flags}) == len(entry.flags),
            "each flag at most once for each scene",
        ),
        (
            "resamples that are too large or not finite",
            all((np.abs(card.score().resampled) <= LARGEST).all() for card in cards),
            f"numbers up to {LARGEST:.0e}",
        ),
        (
            "a curve whose lines do not have the length of its axis",
            all(len({*map(len, of_curve)}) == 1 for of_curve in lines),
            "lines and an axis of equal length",
        ),
    ):
        if not holds:
            raise WeightsError(where, got=got, expected=expected, hint=HINT)
