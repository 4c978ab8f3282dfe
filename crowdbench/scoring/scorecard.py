"""Scorecards: the results of an evaluation, complete enough to rank entries again later.

An entry is a spawn model with a policy. For each metric it keeps the plain distance and the energy
score with its resamples (averaged over fits and folds), so that entries of several scorecards can
be compared on the same resamples. The anchors that define the scale of the scores are part of the
scene (`anchors.json.gz`).
"""

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal, TypeAlias, get_args

import msgspec
import numpy as np
from jaxtyping import Float

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, sha256, write_json
from crowdbench.scene import Gate, Scene
from crowdbench.scoring.energy import RESAMPLES, Energy
from crowdbench.scoring.reference import scored_statistics

SCHEMA = 4

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
)
"""The unranked baselines that every table shows: pairs of a spawn model and a policy."""

GATE_STANDARD = ("replay", "recorded-paths")
"""The spawn model and policy whose speed and arrivals are the standard of the scene's gate."""


_BYTES = 4 + 2 * RESAMPLES
Resamples: TypeAlias = Annotated[bytes, msgspec.Meta(min_length=_BYTES, max_length=_BYTES)]
"""`scoring.energy.RESAMPLES` numbers as whole steps from a centre, see `pack` (base64 in JSON)."""
STEPS = 64
"""A standard deviation of the resamples has at least this number of steps."""
_MOST = np.iinfo(np.int16).max


def pack(centre: float, resampled: Float[np.ndarray, " R"]) -> bytes:
    """Resamples as whole steps from their centre, each in two bytes.

    The step (a float32) comes first, then the lower bytes of all numbers, then the higher ones,
    which are nearly equal and take little space when the file is compressed.
    """
    change = resampled - centre
    fine, coarse = float(change.std()) / STEPS, float(np.abs(change).max()) / _MOST
    # A power of two, so that steps are exact; not so small that the largest number has no place.
    step = max(2.0 ** np.floor(np.log2(fine)) if fine else 0.0,
               2.0 ** np.ceil(np.log2(coarse)) if coarse else 0.0)  # fmt: skip
    steps = np.rint(change / step if step else change).astype("<i2")
    return np.float32(step).tobytes() + steps.view(np.uint8).reshape(-1, 2).T.tobytes()


def unpack(centre: float, packed: bytes) -> Float[np.ndarray, " R"]:
    """The resamples in what `pack` has returned."""
    step = np.frombuffer(packed[:4], "<f4").astype(np.float64)
    both = np.frombuffer(packed[4:], np.uint8).reshape(2, -1)
    return centre + step * np.ascontiguousarray(both.T).view("<i2")[:, 0]


class EnergyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An energy score, averaged over fits and folds."""

    centre: float
    resampled: Resamples

    @classmethod
    def of(cls, energy: Energy) -> "EnergyCard":
        """The card of an energy score; its resamples are rounded, see `pack`."""
        return cls(centre=energy.centre, resampled=pack(energy.centre, energy.resampled))

    def energy(self) -> Energy:
        """The energy score and its resamples as numbers."""
        return Energy(self.centre, unpack(self.centre, self.resampled))


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


def has_recorded_arrivals(card: Scorecard) -> bool:
    """Whether the policies were also evaluated under the recorded arrivals."""
    return any(entry.spawn == "replay" for entry in card.entries)


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
    for protocol in get_args(Protocol):
        scale = anchors.protocols.get(protocol)
        there = {(e.spawn, e.policy) for e in (scale.anchors if scale else ())}
        if missing := sorted(set(BASELINES) - there):
            lacking = f"anchors without {missing}"
            raise WeightsError(path, got=lacking, expected="all anchors", hint=hint)
    return anchors
