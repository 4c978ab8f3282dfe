"""Scorecards: the results of an evaluation, complete enough to rank entries again later.

An entry is a spawn model with a policy. For each metric it keeps the plain distance and the energy
score with its resamples (averaged over fits and folds), so that entries of several scorecards can
be compared on the same resamples. The anchors that define the scale of the scores are part of the
scene (`anchors.json.gz`).
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from crowdbench.errors import CrowdbenchError, RecordingError, WeightsError
from crowdbench.files import read_struct, sha256, write_json
from crowdbench.metrics import METRICS, WALK
from crowdbench.scene import Gate, Scene
from crowdbench.scoring.energy import RESAMPLES, Energy
from crowdbench.scoring.ranking import ranks_of
from crowdbench.scoring.reference import scored_statistics
from crowdbench.scoring.score import (
    Score,
    crowd_score,
    family_scores,
    overall_score,
    score_of,
    walk_score,
)

SCHEMA = 3

Protocol = Literal["full", "heldout"]
Limit = Literal["speed", "arrivals"]
"""A limit of a scene's gate, see `crowdbench.scene.Gate`."""

ANCHOR = ("poisson-gmm", "straight")
"""The spawn model and policy that score 0 in arrivals, presence, trips and space."""
WALK_ANCHOR = ("replay", "straight")
"""The spawn model and policy that score 0 in motion and interaction."""
BASELINES = (
    ANCHOR,
    WALK_ANCHOR,
    ("replay", "replay"),
    ("replay", "recorded-paths"),
    ("replay", "random"),
    ("block-replay", "straight"),
    ("poisson-gmm", "random"),
)
"""The unranked baselines that every table shows: pairs of a spawn model and a policy."""

GATE_STANDARD = ("replay", "recorded-paths")
"""The spawn model and policy whose speed and arrivals are the standard of the scene's gate."""


class EnergyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An energy score, averaged over fits and folds."""

    centre: float
    resampled: bytes
    """The resamples, as float32 in little-endian order (base64 in JSON)."""

    @classmethod
    def of(cls, energy: Energy) -> "EnergyCard":
        """The card of an energy score; its resamples are rounded to float32."""
        return cls(centre=energy.centre, resampled=energy.resampled.astype("<f4").tobytes())

    def energy(self) -> Energy:
        """The energy score and its resamples as numbers."""
        return Energy(self.centre, np.frombuffer(self.resampled, "<f4").astype(np.float64))


class MetricCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Results of one metric for one entry."""

    distance: float | None
    """Plain distance, averaged over rollouts and folds; 0 means equal, None undefined."""
    distances: list[float | None]
    """Distance of each rollout, by seed (for `heldout`, fold by fold)."""
    recorded: float | None
    """Typical value of the recording in `unit`, averaged over folds."""
    simulated: float | None
    unit: str
    n: int
    """Total sample size of all rollouts."""
    energy: EnergyCard | None
    """None if the entry has no score in this metric."""


class PairResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Results of a spawn model with a policy."""

    spawn: str
    policy: str
    seeds: list[int]
    """Random seed of each rollout; in each split, rollout k uses fit k mod `fits`."""
    persons: int
    """Total number of persons in all rollouts."""
    outcomes: dict[str, int]
    """Number of persons by outcome."""
    speed_mps: float | None
    """Mean speed of people who walk (above 0.3 m/s); None if nobody does."""
    at_goal: float | None
    """Share of people at their goals, of those whose trips ended; None if no outcome is known."""
    metrics: dict[str, MetricCard]


class Scale(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The reference points of the scores in one protocol; energies only of the scored metrics."""

    floor: dict[str, EnergyCard]
    """Noise floor F by metric."""
    anchors: list[PairResult]
    """Results of the pairs in `BASELINES`."""

    def of(self, scored: Collection[str]) -> "Scale":
        """The scale without energies of other metrics than these; distances are kept."""
        change = msgspec.structs.replace
        anchors = [
            change(pair, metrics={
                name: card if name in scored else change(card, energy=None)
                for name, card in pair.metrics.items()
            })
            for pair in self.anchors
        ]  # fmt: skip
        return Scale(floor={n: f for n, f in self.floor.items() if n in scored}, anchors=anchors)


class Anchors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of `anchors.json.gz`."""

    schema: int
    scene: str
    made_from: str
    """Hash of the files that the anchors were computed from; see `files_of`."""
    protocols: dict[str, Scale]


class Scorecard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of `scorecard.json`."""

    schema: int
    crowdbench: str
    scene: str
    made_from: str
    protocol: Protocol
    horizon_s: float
    blocks: int
    fits: int
    rollouts: int
    """Number of rollouts per entry (per fold in the protocol `heldout`)."""
    resamples: int
    scored: list[str]
    """Names of the scored metrics."""
    gate: Gate
    """Limits of speed and arrivals beyond which `walk` is at most 0."""
    scale: Scale
    entries: list[PairResult]


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the table of scores."""

    spawn: str
    policy: str
    kind: Literal["entry", "baseline"]
    entry: PairResult
    families: dict[str, Score]
    """Score of each family; motion and interaction are scored under the recorded arrivals."""
    crowd: Score | None
    """Mean over arrivals, presence, trips and space; evaluates the spawn model if `policy` is
    `straight`."""
    walk: Score | None
    """The lesser of motion and interaction; None if the recording is needed and not imported."""
    overall: Score | None
    """Mean of crowd and walk."""
    fails: tuple[Limit, ...]
    """Why the policy does not pass the scene's gate, `speed` and `arrivals`; empty if it does."""
    rank: int | None
    """Rank by the score that `ranked_by` names; None if the row does not compete."""

    @property
    def walk_without_gate(self) -> Score | None:
        """What `walk` would be if the policy passed the scene's gate."""
        return walk_score(self.families, passes=True)


def has_recorded_arrivals(card: Scorecard) -> bool:
    """Whether the policies were also evaluated under the recorded arrivals."""
    return any(entry.spawn == "replay" for entry in card.entries)


def scale_of(card: Scorecard) -> dict[str, tuple[Energy, Energy]]:
    """Noise floor and energy score of the anchor for each scored metric."""
    by_pair = {(e.spawn, e.policy): e for e in card.scale.anchors}
    scale = {}
    for metric in METRICS:
        walks = metric.family in WALK
        anchor = by_pair[WALK_ANCHOR if walks else ANCHOR].metrics.get(metric.name)
        floor = card.scale.floor.get(metric.name)
        if metric.name not in card.scored or anchor is None or floor is None:
            continue
        if anchor.energy is not None:
            nothing = Energy(0.0, np.zeros(card.resamples))
            scale[metric.name] = (nothing if walks else floor.energy(), anchor.energy.energy())
    return scale


def metric_scores(
    scale: dict[str, tuple[Energy, Energy]], entry: PairResult
) -> dict[str, Score | None]:
    """The score of an entry in each scored metric, on the scale of `scale_of`; None for none."""
    scores: dict[str, Score | None] = {}
    for name, (floor, anchor) in scale.items():
        energy = entry.metrics[name].energy
        scores[name] = score_of(energy.energy(), floor, anchor) if energy is not None else None
    return scores


def rows(card: Scorecard) -> list[Row]:
    """The table of a scorecard: its entries in their order, then the baselines.

    The scores of motion and interaction are those of the policy under the recorded arrivals
    (spawn model `replay`). They apply to all entries with the same policy.
    """
    everyone = [*card.entries, *card.scale.anchors]
    scale = scale_of(card)
    of_entry = {id(e): metric_scores(scale, e) for e in everyone}
    under_recorded = {e.policy: e for e in reversed(everyone) if e.spawn == "replay"}
    walkers = {policy: of_entry[id(e)] for policy, e in under_recorded.items()}
    recorded = has_recorded_arrivals(card)

    def row(entry: PairResult, kind: Literal["entry", "baseline"]) -> Row:
        scores = dict(of_entry[id(entry)])
        # The walk scores of baselines are shipped; those of entries need the imported recording.
        if kind == "baseline" or recorded:
            for metric in METRICS:
                if metric.family in WALK and metric.name in walkers.get(entry.policy, {}):
                    scores[metric.name] = walkers[entry.policy][metric.name]
        families = family_scores(METRICS, scores, card.scored)
        walker = under_recorded.get(entry.policy) if kind == "baseline" or recorded else None
        fails = () if walker is None else failures(card, walker)
        crowd, walk = crowd_score(families), walk_score(families, passes=not fails)
        whole = overall_score(crowd, walk)
        return Row(
            entry.spawn, entry.policy, kind, entry, families, crowd, walk, whole, fails, None
        )

    pairs = {(e.spawn, e.policy) for e in card.entries}
    entries = [row(e, "entry") for e in card.entries]
    others = [e for e in card.scale.anchors if (e.spawn, e.policy) not in pairs]
    ranked = [replace(r, rank=k) for r, k in zip(entries, ranks_of(entries), strict=True)]
    return [*ranked, *(row(e, "baseline") for e in others)]


def walker_of(card: Scorecard, policy: str) -> PairResult | None:
    """A policy's result under the recorded arrivals, which the gate judges; None without one."""
    everyone = [*card.entries, *card.scale.anchors]
    return next((e for e in everyone if (e.spawn, e.policy) == ("replay", policy)), None)


def gate_standard(card: Scorecard) -> PairResult:
    """The result of recorded people walked under the rules of the simulation."""
    return next(e for e in card.scale.anchors if (e.spawn, e.policy) == GATE_STANDARD)


def failures(card: Scorecard, entry: PairResult) -> tuple[Limit, ...]:
    """Which limits of the scene's gate a policy exceeds, `speed` or `arrivals`; empty for none.

    `entry` is the policy's result under the recorded arrivals. Its mean walking speed and its share
    of people at their goals are compared with those of recorded people walked. A share that is
    unknown, as for the policy `replay`, is not compared.
    """
    standard = gate_standard(card)
    exceeded: list[Limit] = []
    if standard.speed_mps is not None:
        speed = 0.0 if entry.speed_mps is None else entry.speed_mps
        if abs(speed / standard.speed_mps - 1) > card.gate.speed:
            exceeded.append("speed")
    at_goal = 1.0 if entry.at_goal is None else entry.at_goal
    if standard.at_goal is not None and at_goal < card.gate.arrivals * standard.at_goal:
        exceeded.append("arrivals")
    return tuple(exceeded)


def files_of(scene: Scene) -> str:
    """Hash of everything that the scene's anchors and scores depend on.

    This includes the scene's rules, its settings of scores, areas, `poisson-gmm` rates, and the
    reference statistics of the scored metrics.
    """
    settings = msgspec.json.encode([scene.walking, scene.gate])
    areas, rates = ((scene.folder / n).read_bytes() for n in ("areas.json", "poisson-gmm.json"))
    return sha256(b"".join([scene.rules, settings, areas, rates, scored_statistics(scene)]))[:16]


def write_anchors(anchors: Anchors, folder: Path) -> Path:
    """Write `anchors.json.gz` into a scene's folder."""
    path = folder / "anchors.json.gz"
    write_json(path, anchors)
    return path


def read_anchors(scene: Scene) -> Anchors:
    """The anchors that a scene ships.

    Raises:
        WeightsError: the file is missing or broken, or belongs to another scene or other fits.
    """
    path = scene.folder / "anchors.json.gz"
    hint = f"Run `crowdbench scene anchors {scene.asked}`."
    anchors = read_struct(path, Anchors, WeightsError, hint)
    got = (anchors.scene, anchors.schema, anchors.made_from)
    expected = (scene.id, SCHEMA, files_of(scene))
    if got != expected:
        raise WeightsError(
            path,
            got=f"anchors of {got[0]}, schema {got[1]}, from files with hash {got[2]}",
            expected=f"anchors of {expected[0]}, schema {expected[1]}, hash {expected[2]}",
            hint=hint,
        )
    if set(anchors.protocols) != {"full", "heldout"}:
        raise WeightsError(
            path,
            got=f"anchors of {', '.join(anchors.protocols) or 'no protocol'}",
            expected="anchors of full and heldout",
            hint=hint,
        )
    for scale in anchors.protocols.values():
        _check(scale, path, hint, WeightsError)
    return anchors


def read_scorecard(path: Path) -> Scorecard:
    """Read a `scorecard.json`.

    Raises:
        RecordingError: the file is missing or broken, or has another schema version.
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
    """Raise `error` if anchors are missing or a number of resamples is wrong."""
    missing = set(BASELINES) - {(e.spawn, e.policy) for e in scale.anchors}
    lengths = {
        len(m.energy.resampled) for e in scale.anchors for m in e.metrics.values() if m.energy
    } | {len(f.resampled) for f in scale.floor.values()}
    if missing or lengths - {4 * RESAMPLES}:
        raise error(
            path,
            got=f"anchors without {sorted(missing)}" if missing else "a wrong number of resamples",
            expected=f"all anchors, {RESAMPLES} resamples each",
            hint=hint,
        )
