"""Scorecards: what an evaluation found, complete enough to rank entries again later.

An entry is a spawn model with a policy. It keeps, for each metric, the plain distance and the
energy score with its resamples (averaged over fits and folds), so that entries of several
scorecards can be compared on the resamples they share. The anchors that every scorecard is
measured by come with the scene (`anchors.json`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from crowdbench.errors import CrowdbenchError, RecordingError, WeightsError
from crowdbench.files import read_struct, sha256, write_json
from crowdbench.metrics import METRICS, WALK
from crowdbench.scene import Scene
from crowdbench.scoring.energy import RESAMPLES, Energy
from crowdbench.scoring.score import Score, family_scores, overall, ranks, score_of
from crowdbench.spawn.scenario import split

SCHEMA = 2

Protocol = Literal["full", "heldout"]

ANCHOR = ("poisson-gmm", "straight")
"""What scores 0 in arrivals, presence, lives and space."""
WALK_ANCHOR = ("replay", "straight")
"""What scores 0 in motion and interaction."""
ANCHORS = (
    ANCHOR,
    WALK_ANCHOR,
    ("replay", "replay"),
    ("replay", "random"),
    ("block-replay", "straight"),
    ("poisson-gmm", "random"),
)
"""The pairs that every table shows."""


class EnergyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An energy score, averaged over fits and folds."""

    centre: float
    resampled: bytes
    """Its resamples, float32 in little-endian order (base64 in JSON)."""

    @classmethod
    def of(cls, energy: Energy) -> "EnergyCard":
        """Round the resamples to float32."""
        return cls(centre=energy.centre, resampled=energy.resampled.astype("<f4").tobytes())

    def energy(self) -> Energy:
        """The numbers."""
        return Energy(self.centre, np.frombuffer(self.resampled, "<f4").astype(np.float64))


class MetricCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One metric of one entry."""

    distance: float | None
    """Plain distance, averaged over rollouts and folds; 0 is equal, None undefined."""
    distances: list[float | None]
    """Each rollout's (for `heldout` each fold's one after the other), by seed."""
    recorded: float | None
    """Typical value of the recording, in `unit`; averaged over folds."""
    simulated: float | None
    unit: str
    n: int
    """Sample size of all rollouts together."""
    energy: EnergyCard | None
    """None where the entry is not scored in this metric."""


class PairResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spawn model with a policy."""

    spawn: str
    policy: str
    seeds: list[int]
    """Of the rollouts; seed k of a part is of fit k mod `fits`."""
    persons: int
    """In all rollouts together."""
    outcomes: dict[str, int]
    """How their lives ended."""
    metrics: dict[str, MetricCard]


class Scale(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What scores of one protocol are measured by."""

    floor: dict[str, EnergyCard]
    """F by metric."""
    anchors: list[PairResult]
    """Of the pairs in `ANCHORS`."""


class Anchors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `anchors.json` holds."""

    schema: int
    scene: str
    made_from: str
    """Hash of the files that the anchors were computed with."""
    protocols: dict[str, Scale]


class Scorecard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `scorecard.json` holds."""

    schema: int
    crowdbench: str
    scene: str
    made_from: str
    protocol: Protocol
    horizon_s: float
    blocks: int
    fits: int
    rollouts: int
    """Rollouts of each entry (in each fold)."""
    resamples: int
    scored: list[str]
    """Metrics that count."""
    scale: Scale
    entries: list[PairResult]


@dataclass(frozen=True, eq=False)
class Row:
    """A line of the table."""

    spawn: str
    policy: str
    kind: Literal["entry", "anchor"]
    entry: PairResult
    families: dict[str, Score]
    """Of walking, those of the policy under the recorded arrivals."""
    crowd: Score | None
    """Mean over arrivals, presence, lives and space; with straight walkers the spawn score."""
    walk: Score | None
    """Mean over motion and interaction; None where the recording is needed and missing."""
    overall: Score | None
    rank: int | None
    """By `overall` where every entry has one, else by `crowd`."""


def walked(card: Scorecard) -> bool:
    """Whether policies were walked under the recorded arrivals."""
    return any(entry.spawn == "replay" for entry in card.entries)


def scale_of(card: Scorecard) -> dict[str, tuple[Energy, Energy]]:
    """Floor and anchor of each scored metric."""
    by_pair = {(e.spawn, e.policy): e for e in card.scale.anchors}
    found = {}
    for metric in METRICS:
        walks = metric.family in WALK
        anchor = by_pair[WALK_ANCHOR if walks else ANCHOR].metrics.get(metric.name)
        floor = card.scale.floor.get(metric.name)
        if metric.name not in card.scored or anchor is None or floor is None:
            continue
        if anchor.energy is not None:
            nothing = Energy(0.0, np.zeros(card.resamples))
            found[metric.name] = (nothing if walks else floor.energy(), anchor.energy.energy())
    return found


def metric_scores(card: Scorecard, entry: PairResult) -> dict[str, Score | None]:
    """The score of an entry in each scored metric; None where it has none."""
    scores: dict[str, Score | None] = {}
    for name, (floor, anchor) in scale_of(card).items():
        energy = entry.metrics[name].energy
        scores[name] = score_of(energy.energy(), floor, anchor) if energy is not None else None
    return scores


def rows(card: Scorecard) -> list[Row]:
    """The table of a scorecard: its entries in their order, then the anchors.

    Entries that only walk (recorded arrivals) lend their families of walking to all entries of
    the same policy.
    """
    everyone = [*card.entries, *card.scale.anchors]
    of_entry = {id(e): metric_scores(card, e) for e in everyone}
    walkers = {e.policy: of_entry[id(e)] for e in reversed(everyone) if e.spawn == "replay"}
    recorded = walked(card)

    def row(entry: PairResult, kind: Literal["entry", "anchor"]) -> Row:
        scores = dict(of_entry[id(entry)])
        # An anchor's walk scores are shipped; an entry's need its own rollouts, hence a recording.
        if kind == "anchor" or recorded:
            for metric in METRICS:
                if metric.family in WALK and metric.name in walkers.get(entry.policy, {}):
                    scores[metric.name] = walkers[entry.policy][metric.name]
        families = family_scores(METRICS, scores, card.scored)
        crowd = overall({f: s for f, s in families.items() if f not in WALK}, walk=False)
        walk = overall({f: s for f, s in families.items() if f in WALK}, walk=True)
        whole = overall(families, walk=True) if crowd is not None and walk is not None else None
        return Row(entry.spawn, entry.policy, kind, entry, families, crowd, walk, whole, None)

    pairs = {(e.spawn, e.policy) for e in card.entries}
    entries = [row(e, "entry") for e in card.entries]
    anchors = [row(e, "anchor") for e in card.scale.anchors if (e.spawn, e.policy) not in pairs]
    return [*_ranked(entries), *anchors]


def steered(spawn: str) -> bool:
    """Whether a spawn model is under a scenario."""
    return split(spawn)[1] is not None


def may_rank(spawn: str) -> bool:
    """Whether a spawn model is to be as the recording by what it learned.

    Played recordings are so by heart, and steered models are to be different.
    """
    return spawn not in ("replay", "block-replay") and not steered(spawn)


def _ranked(entries: Sequence[Row]) -> list[Row]:
    competing = [r for r in entries if may_rank(r.spawn)]
    by_overall = all(r.overall is not None for r in competing)
    scores = [r.overall if by_overall else r.crowd for r in competing]
    known = [s for s in scores if s is not None]
    if len(known) < len(competing) or not competing:
        return list(entries)
    rank = dict(zip(map(id, competing), ranks(known), strict=True))
    return [replace(r, rank=rank.get(id(r))) for r in entries]


def files_of(scene: Scene) -> str:
    """Hash of what the scene's anchors and scores depend on: its rules and shipped files."""
    names = ("areas.json", "poisson-gmm.json", "reference.json")
    rules = {
        f.name: getattr(scene, f.name)
        for f in fields(scene)
        if f.name not in ("title", "folder", "clustering")
    }
    rules["protocol"] = msgspec.structs.replace(scene.protocol, scored=())
    parts = [msgspec.json.encode(rules, order="deterministic")]
    parts += [(scene.folder / name).read_bytes() for name in names]
    return sha256(b"".join(parts))[:16]


def write_anchors(anchors: Anchors, folder: Path) -> Path:
    """Write `anchors.json` into a scene's folder."""
    path = folder / "anchors.json"
    write_json(path, anchors, compact=True)
    return path


def read_anchors(scene: Scene) -> Anchors:
    """The anchors that a scene ships.

    Raises:
        WeightsError: the file is missing, broken, another scene's, or of other fits.
    """
    path = scene.folder / "anchors.json"
    hint = f"Run `crowdbench anchors {scene.asked}`."
    anchors = read_struct(path, Anchors, WeightsError, hint)
    got = (anchors.scene, anchors.schema, anchors.made_from)
    expected = (scene.id, SCHEMA, files_of(scene))
    if got != expected:
        raise WeightsError(
            path,
            got=f"anchors of {got[0]}, schema {got[1]}, by rules and files of hash {got[2]}",
            expected=f"{expected[0]}, schema {expected[1]}, hash {expected[2]}",
            hint=hint,
        )
    if set(anchors.protocols) != {"full", "heldout"}:
        raise WeightsError(
            path,
            got=f"anchors of {', '.join(anchors.protocols) or 'no protocol'}",
            expected="full and heldout",
            hint=hint,
        )
    for scale in anchors.protocols.values():
        _check(scale, path, hint, WeightsError)
    return anchors


def read_scorecard(path: Path) -> Scorecard:
    """Read a `scorecard.json`.

    Raises:
        RecordingError: the file is missing or broken, or of another schema version.
    """
    hint = "Run `crowdbench evaluate` again."
    try:
        card = read_struct(path, Scorecard, RecordingError, hint)
    except RecordingError as error:
        schema = _schema_of(path)
        if schema in (None, SCHEMA):
            raise
        raise RecordingError(
            path, got=f"schema {schema}", expected=f"schema {SCHEMA}", hint=hint
        ) from error
    if card.schema != SCHEMA:
        raise RecordingError(
            path, got=f"schema {card.schema}", expected=f"schema {SCHEMA}", hint=hint
        )
    _check(card.scale, path, hint, RecordingError)
    return card


def _schema_of(path: Path) -> object:
    try:
        return msgspec.json.decode(path.read_bytes()).get("schema")
    except (OSError, msgspec.DecodeError, AttributeError):
        return None


def _check(scale: Scale, path: Path, hint: str, error: type[CrowdbenchError]) -> None:
    """Raise where anchors are missing or resamples are not as many as they should be."""
    missing = set(ANCHORS) - {(e.spawn, e.policy) for e in scale.anchors}
    lengths = {
        len(m.energy.resampled) for e in scale.anchors for m in e.metrics.values() if m.energy
    } | {len(f.resampled) for f in scale.floor.values()}
    if missing or lengths - {4 * RESAMPLES}:
        raise error(
            path,
            got=f"anchors without {sorted(missing)}" if missing else "resamples cut short",
            expected=f"all anchors, {RESAMPLES} resamples each",
            hint=hint,
        )
