"""The page of results: all crowds, pictures that are there, and what the models miss."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pages
import pytest

from crowdbench import __version__
from crowdbench.data.storage import read_own
from crowdbench.metrics import METRICS
from crowdbench.registry import import_recording
from crowdbench.report.text.words import plainly, with_interval
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import (
    SCHEMA,
    PairResult,
    Protocol,
    Scorecard,
    read_anchors,
)
from studies.__main__ import main as studies_main
from studies.results.correlations import Lag, at_lags
from studies.results.drawing import FIGURES
from studies.results.misses import QUANTITIES
from studies.results.page import of_recording, page
from studies.results.pictures import Picture

pytestmark = pytest.mark.long

PLAZA = load_scene("plaza-v0")
REFERENCE = read_reference(PLAZA)
LAGS = [Lag(10.0, 0.61, 0.42), Lag(30.0, 0.15, -0.07)]
PICTURES = [Picture("dwell.png", "Dwell time", "How long people stay.")]


def read_scorecard(path: Path) -> Scorecard:
    return msgspec.json.decode(path.read_bytes(), type=Scorecard)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def written(folder: Path) -> Path:
    """The page of the plaza by its own command, but with one rollout of each crowd: distances, no
    scores."""
    asked = pages.arguments("docs/results/plaza-v0.md", "python -m studies results", small=False)
    import_recording("plaza")  # once: else it is generated wherever it is looked at
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert studies_main(["results", *asked, "--seeds", "1"]) == 0
    return folder / "docs/results/plaza-v0.md"


def anchor(spawn: str, policy: str, /, **changes: object) -> PairResult:
    """One of the scene's anchors, as if it had been evaluated."""
    anchors = read_anchors(PLAZA).protocols["full"].anchors
    found = next(e for e in anchors if (e.spawn, e.policy) == (spawn, policy))
    return msgspec.structs.replace(found, **changes)


def card_of(protocol: Protocol, *entries: PairResult, **changes: object) -> Scorecard:
    card = Scorecard(
        schema=SCHEMA,
        crowdbench=__version__,
        scene=PLAZA.id,
        made_from="0123456789abcdef",
        protocol=protocol,
        horizon_s=PLAZA.horizon_s,
        blocks=len(REFERENCE.blocks),
        fits=PLAZA.protocol.fits,
        rollouts=30,
        resamples=RESAMPLES,
        scored=list(PLAZA.protocol.scored),
        gate=PLAZA.gate,
        scale=read_anchors(PLAZA).protocols[protocol],
        entries=list(entries),
    )
    return msgspec.structs.replace(card, **changes)


def with_metric_of(entry: PairResult, name: str, other: PairResult) -> PairResult:
    """The entry, in one metric as bad as another."""
    return msgspec.structs.replace(entry, metrics=entry.metrics | {name: other.metrics[name]})


WALKERS = (anchor("replay", "straight"), anchor("replay", "random"))
POISSON = anchor("poisson-gmm", "straight")
RIGHT = anchor("replay", "replay", spawn="ntpp-gmm", policy="straight")
"""A model that is as good as the recording itself."""


def page_of(*entries: PairResult, **changes: object) -> str:
    cards: dict[Protocol, Scorecard] = {
        "full": card_of("full", *entries, **changes),
        "heldout": card_of("heldout", *entries, **changes),
    }
    return page(PLAZA, cards, {"full": LAGS, "heldout": LAGS}, PICTURES)


def section(text: str, *heads: str) -> str:
    """What stands below the headings, one below the other, on one line."""
    for head in heads:
        level = head.split()[0]
        text = re.split(rf"^{re.escape(head)}$", text, flags=re.M)[1]
        text = re.split(rf"^#{{1,{len(level)}}} ", text, flags=re.M)[0]
    return re.sub(r"\s+", " ", text)


def missed(text: str) -> str:
    """What is said of the models in the full protocol."""
    return section(text, "## What the models miss", "### Full")


def low(text: str, family: str) -> dict[str, list[str]]:
    """The low metrics of a family in the full protocol: the cells after its name."""
    found = re.findall(rf"\| {family} \| ([^|]+) \| ((?:[^|]+\| ){{4}}[^|]+) \|", missed(text))
    return {name: cells.split(" | ") for name, cells in found}


def test_each_crowd_and_each_anchor_has_its_row_in_both_protocols(
    written: Path, folder: Path
) -> None:
    text = written.read_text(encoding="utf-8")
    for protocol, head in (("full", "### Full"), ("heldout", "### Held out")):
        scores = section(text, "## Scores", head)
        card = read_scorecard(folder / "results" / f"plaza-v0-{protocol}" / "scorecard.json")
        names = [f"{row.spawn} × {row.policy}" for row in rows(card)]
        assert len(names) == 12
        found = re.findall(r"\| \*?([\w-]+ × [\w-]+)\*? \|", scores)
        assert found[1:] == names  # the first is of the head


def test_distances_are_those_of_the_scorecards(written: Path, folder: Path) -> None:
    text = written.read_text(encoding="utf-8")
    for protocol, head in (("full", "### Full"), ("heldout", "### Held out")):
        shown = section(text, "## Distances", head)
        card = read_scorecard(folder / "results" / f"plaza-v0-{protocol}" / "scorecard.json")
        for entry in card.entries:
            for metric in entry.metrics.values():
                assert metric.distance is not None
                several = len(metric.distances) > 1
                spread = f" ± {np.std(metric.distances, ddof=1):.3f}" if several else ""
                assert f"| {metric.distance:.3f}{spread} |" in shown


def test_pictures_are_there_and_small(written: Path) -> None:
    links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", written.read_text(encoding="utf-8"))
    assert {Path(link).name for link in links} == set(FIGURES)
    for link in links:
        data = (written.parent / link).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) < 200_000, link
    assert {p.name for p in (written.parent / "plaza-v0").iterdir()} == set(FIGURES)


def test_without_scores_nothing_is_said_to_be_missed(written: Path) -> None:
    text = written.read_text(encoding="utf-8")
    assert "There are no scores. Rollouts of each crowd: 1." in missed(text)
    assert "python -m studies results plaza-v0 --seeds 1" in text


def test_the_same_cards_give_the_same_bytes() -> None:
    assert page_of(POISSON, RIGHT, *WALKERS) == page_of(POISSON, RIGHT, *WALKERS)


def test_a_metric_that_is_bad_is_named_with_both_values() -> None:
    """In a model that is right in all else, one metric as bad as random walkers have it."""
    right = page_of(POISSON, RIGHT, *WALKERS)
    assert low(right, "space") == {}
    assert "(space)" in missed(right).split("Lowest scored metric of each other family: ")[1]
    bad = with_metric_of(RIGHT, "nearest_neighbour", anchor("replay", "random"))
    text = page_of(POISSON, bad, *WALKERS)
    metric = bad.metrics["nearest_neighbour"]
    said = low(text, "space")
    assert list(said) == ["nearest neighbour"]
    what, score, recorded, simulated, _ = said["nearest neighbour"]
    assert what == "mean distance to the nearest neighbour"
    assert re.match(r"−?0\.\d\d \[", score)
    assert (recorded, simulated) == (f"{metric.recorded:#.3g} m", f"{metric.simulated:#.3g} m")
    assert low(text, "arrivals") == low(right, "arrivals") == {}


def test_scores_are_those_of_the_table() -> None:
    card = card_of("full", POISSON, RIGHT, *WALKERS)
    scores = section(page_of(POISSON, RIGHT, *WALKERS), "## Scores", "### Full")
    for row in rows(card):
        assert row.crowd is not None
        families = [row.families[f] for f in ("arrivals", "presence", "trips", "space")]
        shown = " | ".join([*(plainly(s.value) for s in families), with_interval(row.crowd)])
        assert f"| {shown} |" in scores


def test_how_much_and_how_long_the_number_present_moves_is_always_told() -> None:
    said = missed(page_of(POISSON, RIGHT, *WALKERS))
    spread = RIGHT.metrics["agents_sd"]
    both = f"{spread.recorded:.2f} persons | {spread.simulated:.2f} persons"
    assert f"| standard deviation | {both} |" in said
    assert "| autocorrelation at 10 s | 0.61 | 0.42 |" in said
    assert "| autocorrelation at 30 s | 0.15 | −0.07 |" in said


def test_what_is_not_scored_is_said_not_to_be() -> None:
    scored = [n for n in PLAZA.protocol.scored if n not in ("autocorrelation", "dwell", "detour")]
    text = page_of(POISSON, RIGHT, *WALKERS, scored=scored)
    assert "(trips)" not in missed(text)
    said = section(text, "### What is not scored")
    first = "autocorrelation, slow autocorrelation, dwell, origin destination, detour"
    assert f"Plain distances only: {first}" in said
    assert "Families without a scored metric, left out of all means: *trips*." in said
    assert "because the time blocks are too short: fano 60 s." in said


def test_models_are_held_against_the_anchor_and_against_memory() -> None:
    """The recording itself is better than both, memory by another name is not."""
    memory = anchor("block-replay", "straight", spawn="renewal-gmm")
    text = page_of(POISSON, RIGHT, memory, *WALKERS)
    said = missed(text)
    assert re.search(r"\| poisson-gmm \(anchor\) \| – \| – \| −0\.\d\d [^|]* \| yes \|", said)
    assert re.search(r"\| ntpp-gmm \| \d\.[^|]* \| yes \| \d\.[^|]* \| yes \|", said)
    assert re.search(r"\| renewal-gmm \| [^|]* \| yes \| 0\.00 \[0\.00, 0\.00\] \| no \|", said)
    assert "The highest crowd score is that of **ntpp-gmm × straight**" in said
    assert "No significant difference: none." in said


def test_without_the_recording_walking_is_not_scored() -> None:
    text = page_of(POISSON, RIGHT)
    assert "(motion)" not in missed(text)
    assert low(text, "motion") == {}
    assert "The recording was not imported" in section(text, "## Scores")


def test_straight_walkers_are_said_to_be_the_anchor_of_walking() -> None:
    text = page_of(POISSON, RIGHT, *WALKERS)
    said = section(text, "## What the models miss")
    assert "straight walkers are their anchor, with a score of 0." in said
    assert low(text, "motion")["turning"][1] == "0.00 [0.00, 0.00]"


def test_a_metric_without_a_span_is_said_to_have_no_score() -> None:
    card = card_of("full", POISSON, RIGHT, *WALKERS)
    low = msgspec.structs.replace(
        card.scale, floor=card.scale.floor | {"detour": POISSON.metrics["detour"].energy}
    )
    text = page_of(POISSON, RIGHT, *WALKERS, scale=low)
    assert "the anchor is no worse than the noise floor: detour." in missed(text)


def test_a_scene_without_scored_metrics() -> None:
    text = page_of(POISSON, RIGHT, *WALKERS, scored=[])
    assert "no metric of this scene is scored yet" in text
    assert "No metric of this scene is scored yet: it has no power study." in text


def test_lines_are_short_and_intervals_whole() -> None:
    lines = page_of(POISSON, RIGHT, *WALKERS).splitlines()
    prose = [line for line in lines if not line.startswith(("|", "!"))]
    assert max(map(len, prose)) <= 100
    assert [line for line in prose if line.count("[") != line.count("]")] == []


def test_lags_average_to_what_the_scorecard_holds(written: Path, folder: Path) -> None:
    work = folder / "results" / "plaza-v0-full"
    crowd = read_own(work / "rollouts" / "ntpp-gmm_social-force_full_0.parquet")
    lags = at_lags(REFERENCE, {"full": [crowd]})
    entry = next(
        e
        for e in read_scorecard(work / "scorecard.json").entries
        if (e.spawn, e.policy) == ("ntpp-gmm", "social-force")
    )
    of_card = entry.metrics["autocorrelation"]
    assert [lag.lag_s for lag in lags] == [10.0, 30.0]
    assert np.mean([lag.simulated for lag in lags]) == pytest.approx(of_card.simulated)
    assert np.mean([lag.recorded for lag in lags]) == pytest.approx(of_card.recorded)


def test_the_picture_of_the_autocorrelation_shows_what_the_metric_compares(
    written: Path, folder: Path
) -> None:
    text = written.read_text(encoding="utf-8")
    said = section(text, "## Pictures", "### Autocorrelation of the number of agents")
    card = read_scorecard(folder / "results" / "plaza-v0-full" / "scorecard.json")
    for entry in card.entries[:6]:
        of_card = entry.metrics["autocorrelation"]
        for name, mean in (
            (f"{entry.spawn} × {entry.policy}", of_card.simulated),
            ("recorded", of_card.recorded),
        ):
            shown = re.findall(rf"{name} (−?[\d.]+\d)", said)
            values = [float(value.replace("−", "-")) for value in shown]
            assert len(values) == 2  # a lag each
            assert np.mean(values) == pytest.approx(mean, abs=0.006)


def test_every_metric_has_words_for_what_it_is_of() -> None:
    assert list(QUANTITIES) == [metric.name for metric in METRICS]


def test_whom_to_cite_is_known_for_every_recording() -> None:
    def with_recording(name: str) -> Scene:
        return replace(PLAZA, recording=msgspec.structs.replace(PLAZA.recording, name=name))

    assert "Majecka" in of_recording(with_recording("forum-14jul"))
    assert "no paper to cite" in of_recording(PLAZA)
    own = of_recording(with_recording("my-hall"))
    assert "my-hall" in own
    assert "cite" not in own
