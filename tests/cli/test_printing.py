"""What the command line prints of a scorecard is legible, however narrow the terminal is."""

import re
from math import nan

import msgspec
import pytest

from crowdbench import __version__
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.score_tables import print_card, print_results
from crowdbench.metrics import FAMILIES, MetricResult
from crowdbench.report.text.words import interval, number
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.scorecard import SCHEMA, PairResult, Scorecard, read_anchors, rows

ETH = load_scene("eth-v0")
ANCHORS = {(e.spawn, e.policy): e for e in read_anchors(ETH).protocols["full"].anchors}
LONG = "ntpp-gmm+docs/steering/rush_hour.toml"
CLASS = "crowdbench.baselines.heuristic:Heuristic"

Printed = pytest.CaptureFixture[str]


def crowd(spawn: str, policy: str, of: tuple[str, str] = ("poisson-gmm", "random")) -> PairResult:
    """A crowd that walks as an anchor does."""
    return msgspec.structs.replace(ANCHORS[of], spawn=spawn, policy=policy)


@pytest.mark.parametrize("what", ["a[/red]b", "a{b}", "[bold]{task.total}", "{0}"])
def test_what_progress_is_of_may_be_any_path(what: str, capsys: Printed) -> None:
    with progress_bar(what) as progress:
        progress(1, 1)
    assert capsys.readouterr().out.startswith(what)


def unscored(entry: PairResult) -> PairResult:
    metrics = {n: msgspec.structs.replace(m, energy=None) for n, m in entry.metrics.items()}
    return msgspec.structs.replace(entry, metrics=metrics)


def card_of(*entries: PairResult, rollouts: int = 30) -> Scorecard:
    return Scorecard(
        schema=SCHEMA, crowdbench=__version__, scene=ETH.id, made_from="", protocol="full",
        horizon_s=ETH.horizon_s, blocks=17, fits=5, rollouts=rollouts, resamples=RESAMPLES,
        scored=list(ETH.protocol.scored), gate=ETH.gate, scale=read_anchors(ETH).protocols["full"],
        entries=list(entries),
    )  # fmt: skip


USUAL = card_of(
    *(
        crowd(spawn, policy)
        for spawn in ("poisson-gmm", "renewal-gmm", "ntpp-gmm")
        for policy in ("straight", "social-force")
    )
)
MANY = card_of(*(crowd(LONG, policy) for policy in ("straight", CLASS)), *USUAL.entries * 2)


def printed(card: Scorecard, capsys: Printed) -> str:
    print_card(card, ETH)
    return capsys.readouterr().out


@pytest.mark.parametrize("card", [USUAL, MANY], ids=["usual", "many"])
@pytest.mark.parametrize("columns", [80, 100, 140, 200])
def test_nothing_is_cut_or_runs_over(
    card: Scorecard, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    out = printed(card, capsys)
    assert max(map(len, out.splitlines())) <= columns
    assert "…" not in out
    for head in ("spawn × policy", "crowd", "walk", "overall", "rank", *FAMILIES, "recorded"):
        assert re.search(rf"^ .*\b{head}\b", out, re.MULTILINE), head
    for k in range(1, len(card.entries) + 1):
        assert re.search(rf"^ distance .* {k}\b", out, re.MULTILINE)


@pytest.mark.parametrize("columns", [80, 100, 140, 200])
def test_usual_crowds_have_a_line_each(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    out = printed(USUAL, capsys)
    for row in rows(USUAL):
        lines = re.findall(rf"^ {row.spawn} × {row.policy} .*$", out, re.MULTILINE)
        together = " ".join(lines)
        assert len(lines) in ((1,) if columns == 200 else (2, 3))
        assert interval(row.crowd) in together
        for family in FAMILIES:
            assert number(row.families.get(family)) in together


def test_long_names_are_folded_between_words(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    out = printed(MANY, capsys)
    assert re.search(
        r"^ ntpp-gmm\+rush_hour ×  +\S.*\n crowdbench\.baselines\.heuristic:Heuristic *$", out, re.M
    )


def test_a_file_has_all_in_one_table(monkeypatch: pytest.MonkeyPatch, capsys: Printed) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    out = printed(MANY, capsys)
    assert out.count("spawn × policy") == 1
    assert len(re.findall(r"^ distance ", out, re.MULTILINE)) == 1
    assert f"ntpp-gmm+rush_hour × {CLASS} " in out


def test_what_needs_the_recording_is_said_below(capsys: Printed) -> None:
    out = printed(USUAL, capsys)
    assert (
        "Scores of motion and interaction need the recording: `crowdbench data fetch eth`." in out
    )
    walked = card_of(crowd("replay", "social-force"), *USUAL.entries)
    assert "data fetch" not in printed(walked, capsys)


@pytest.mark.parametrize(("made", "said"), [(2, "there are 2"), (1, "there is 1")])
def test_why_there_are_no_scores_is_said(made: int, said: str, capsys: Printed) -> None:
    few = card_of(*map(unscored, USUAL.entries), rollouts=made)
    out = " ".join(printed(few, capsys).split())
    assert (
        "Scores are missing: a score needs at least two rollouts for each of the 5 fits, "
        f"that is, 10 of each pair; {said}."
    ) in out
    assert "No scores" not in printed(USUAL, capsys)


def test_a_scene_without_scored_metrics_says_so(capsys: Printed) -> None:
    out = printed(msgspec.structs.replace(USUAL, scored=[]), capsys)
    assert "`crowdbench power eth-v0 --write`" in out


def test_what_is_not_defined_is_a_dash(capsys: Printed) -> None:
    result = MetricResult(distance=nan, recorded=1.5, simulated=nan, unit="m", n=0)
    print_results({"nearest_neighbour": result})
    out = capsys.readouterr().out
    assert re.search(r"nearest neighbour +– +1\.50 m +– +0", out)
    assert "nan" not in out
    assert "0: equal" in out
