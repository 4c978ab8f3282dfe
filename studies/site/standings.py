"""Standings: the entries of a track, with their scores and ranks in every view of its table."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec

from crowdbench.errors import WeightsError
from crowdbench.leaderboard.scores import FAMILIES_OF, View, are_trajectories, scores
from crowdbench.leaderboard.submission.schema import SCENES, Track
from crowdbench.leaderboard.verification.entry import Entry, entry_paths, read_entry
from crowdbench.leaderboard.verification.flags import flags_of, trip_limit
from crowdbench.leaderboard.verification.soundness import check_entry
from crowdbench.scoring.score import Score, ranks
from crowdbench.scoring.scorecard import Limit

TRACKS: tuple[Track, ...] = ("walk", "spawn", "crowd")


class Gate(NamedTuple):
    """How fast people walk and whether they arrive."""

    speed: float | None
    """Mean speed over that of recorded people walked."""
    at_goal: float | None
    fails: set[Limit]
    """The limits that are exceeded on any of the scenes."""


class Copied(NamedTuple):
    """How much of a crowd is like the recording."""

    arrivals: float | None
    trips: float | None
    """Of several scenes, that of the scene where it is largest relative to its limit."""
    trip_limit: float | None
    """The limit of `trips` on that scene."""


@dataclass(frozen=True, eq=False)
class Line:
    """An entry with its scores."""

    entry: Entry
    scores: dict[View, Score]
    """The score in each view in which it has one."""

    @property
    def recorded(self) -> Score | None:
        """The overall score with all people entering exactly as recorded."""
        return scores(self.entry, recorded=True).get(View())

    @property
    def competes(self) -> bool:
        """Whether it is ranked."""
        return self.entry.status == "ranked"

    @property
    def kind(self) -> str:
        """`reference`, `external` or the declared kind; with the reason if it is listed."""
        if not self.competes and self.entry.status != "listed":
            return self.entry.status
        kind = self.entry.declared.kind
        if self.competes:
            return kind
        return f"{kind}, {'trajectories' if are_trajectories(self.entry) else 'full'}"

    def worth(self, view: View) -> tuple[float, str]:
        """Sort key: the best score comes first, and entries without a score last."""
        score = self.scores.get(view)
        return (float("inf") if score is None else -score.value), self.entry.id

    def gate(self, scene: str = "") -> "Gate":
        """Speed and arrivals: on one scene, or the means of all scenes."""
        scenes = [each for name, each in self.entry.scenes.items() if scene in ("", name)]
        ratios = [
            each.speed_mps / each.recorded_speed_mps
            for each in scenes
            if each.speed_mps is not None and each.recorded_speed_mps
        ]
        shares = [each.at_goal for each in scenes if each.at_goal is not None]
        return Gate(
            sum(ratios) / len(ratios) if ratios else None,
            sum(shares) / len(shares) if shares else None,
            {limit for each in scenes for limit in each.fails},
        )

    def copied(self, scene: str = "") -> "Copied":
        """The copy index on one scene, or the highest of all scenes."""
        copies = {
            name: each.copy for name, each in self.entry.scenes.items() if scene in ("", name)
        }
        arrivals = [copy.arrivals for copy in copies.values() if copy.arrivals is not None]
        trips = [
            (copy.trips, trip_limit(name))
            for name, copy in copies.items()
            if copy.trips is not None
        ]
        nearest = max(trips, default=(None, None), key=lambda of: of[0] / of[1])
        return Copied(max(arrivals, default=None), *nearest)


@dataclass(frozen=True, eq=False)
class Standing:
    """The entries of one track, with their ranks."""

    track: Track
    scenes: tuple[str, ...]
    """All scenes of the track; those of the overall score come first."""
    families: tuple[str, ...]
    lines: list[Line]
    """Ranked entries, references, and models of other simulators."""
    listed: list[Line]
    ranks: dict[View, dict[str, int]]
    """Rank by the entry's id; an entry without competitors has none."""
    yours: frozenset[str] | None = None
    """In a preview, ids of the user's own entries; the others come with crowdbench."""
    paged: bool = False
    """Whether each entry has a page."""

    def address(self, line: Line) -> str:
        """Where an entry is described, relative to the leaderboard's folder."""
        if self.paged:
            return f"pages/{line.entry.id}.html"
        external = line.entry.status == "external"
        return "../docs/peers.md" if external else f"submissions/{line.entry.id}"

    @property
    def views(self) -> list[View]:
        """All views of the track."""
        return [View(f, s) for f in ("", *self.families) for s in ("", *self.scenes)]

    def ordered(self, view: View) -> list[Line]:
        """Entries by rank, then by score; one without a rank follows all of at least its score."""
        rank = self.ranks[view]
        best = sorted(self.lines, key=lambda line: line.worth(view))
        found = [line for line in best if line.entry.id in rank]
        found.sort(key=lambda line: rank[line.entry.id])
        for line in (line for line in best if line.entry.id not in rank):
            above = [k for k, o in enumerate(found) if o.worth(view) <= line.worth(view)]
            found.insert(above[-1] + 1 if above else 0, line)
        return found

    def rank(self, line: Line, view: View) -> str:
        """The rank as text: `2`, or `2 =` if it is shared; empty if the entry has none."""
        rank = self.ranks[view].get(line.entry.id)
        if rank is None:
            return ""
        shared = list(self.ranks[view].values()).count(rank) > 1
        return f"{rank}\u202f=" if shared else f"{rank}"


def standing(
    track: Track,
    entries: Sequence[Entry],
    yours: frozenset[str] | None = None,
    *,
    paged: bool = False,
) -> Standing:
    """Compute the standing of one track from all entries; see `Standing` for the last two."""
    own = sorted((e for e in entries if e.declared.track == track), key=lambda entry: entry.id)
    lines = [Line(e, scores(e)) for e in own if e.status != "listed"]
    listed = [Line(e, scores(e)) for e in own if e.status == "listed"]
    others = sorted({name for entry in own for name in entry.scenes} - set(SCENES))
    found = Standing(track, (*SCENES, *others), FAMILIES_OF[track], lines, listed, {}, yours, paged)
    for view in found.views:
        competing = [o for o in lines if o.competes and view in o.scores]
        each = ranks([line.scores[view] for line in competing])
        names = [line.entry.id for line in competing]
        found.ranks[view] = dict(zip(names, each, strict=True)) if len(names) > 1 else {}
    return found


def read_entries(folder: Path, beside: Path | None = None) -> list[Entry]:
    """All entries of a folder, and those of the folder `beside` with other ids.

    Entries in `beside` that another scorer has scored cannot be compared, and are left out. Flags
    of copied trips are those of the present limits.

    Raises:
        WeightsError: an entry is broken, or cannot be compared with the others.
    """
    own = entry_paths(folder)
    paths = (entry_paths(beside) if beside else {}) | own
    entries = [(path, read_entry(path)) for path in paths.values()]
    scorer = max((entry.scorer for _, entry in entries), default=0)
    entries = [(p, e) for p, e in entries if e.id in own or e.scorer == scorer]
    made_from: dict[str, str] = {}
    for path, entry in entries:
        check_entry(entry, path)
        if entry.scorer != scorer:
            raise WeightsError(
                path,
                got=f"scores of scorer {entry.scorer}",
                expected=f"scorer {scorer}, as in other entries",
                hint="Run `python -m studies rescore`.",
            )
        for name, scene in entry.scenes.items():
            if made_from.setdefault(name, scene.made_from) != scene.made_from:
                raise WeightsError(
                    path,
                    got=f"scene {name} with the hash {scene.made_from}",
                    expected=f"the hash {made_from[name]}, as in other entries",
                    hint="Run `python -m studies rescore`.",
                )
    return [with_current_limits(entry) for _, entry in entries]


def with_current_limits(entry: Entry) -> Entry:
    """The entry with its flags of copied trips by the present limits, which may be measured anew.

    Other flags are kept. Raises WeightsError: see `trip_limit`.
    """
    flags = [flag for flag in entry.flags if flag.what != "copied trips"]
    for name, scene in entry.scenes.items():
        only_trips = msgspec.structs.replace(scene.copy, arrivals=None, coarse=[])
        flags += flags_of(name, None, None, only_trips)
    order = entry.declared.scenes
    flags.sort(key=lambda flag: order.index(flag.scene))  # as verification does
    return msgspec.structs.replace(entry, flags=flags)
