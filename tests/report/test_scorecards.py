"""What the command line prints of a scorecard is legible, however narrow the terminal is."""

import re
from math import nan

import msgspec
import pytest

from crowdbench import __version__
from crowdbench.metrics import FAMILIES, WALK, MetricResult
from crowdbench.report.text.scorecards import print_card, print_results
from crowdbench.report.text.words import interval, number
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.ranking import Row, rows
from crowdbench.scoring.scorecard import SCHEMA, PairResult, Scorecard, read_anchors

ETH = load_scene("eth-v0")
ANCHORS = {(e.spawn, e.policy): e for e in read_anchors(ETH).protocols["full"].anchors}
LONG = "ntpp-gmm+docs/steering/rush_hour.toml"
CLASS = "somebody.walkers.of_long_names:Heuristic"

Printed = pytest.CaptureFixture[str]


def crowd(
    spawn: str, policy: str, of: tuple[str, str] = ("block-replay", "straight")
) -> PairResult:
    """A crowd that walks as an anchor does."""
    return msgspec.structs.replace(ANCHORS[of], spawn=spawn, policy=policy)


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
    assert re.search(rf"^ ntpp-gmm\+rush_hour ×  +\S.*\n {re.escape(CLASS)} *$", out, re.M)


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
    assert "`crowdbench scene power eth-v0 --write`" in " ".join(out.split())


def test_what_is_not_defined_is_a_dash(capsys: Printed) -> None:
    result = MetricResult(distance=nan, recorded=1.5, simulated=nan, unit="m", n=0)
    print_results({"nearest_neighbour": result})
    out = capsys.readouterr().out
    assert re.search(r"nearest neighbour +– +1\.50 m +– +0", out)
    assert "nan" not in out
    assert "0: equal" in out


def lines_of(out: str) -> list[str]:
    """The rows of the first table, in their order."""
    table = out.split("spawn × policy")[1].split("\n", 2)[2].split("Scores: 0")[0]
    return [line for line in table.splitlines() if " × " in line]


def test_policies_alone_are_ranked_and_sorted_by_walk(capsys: Printed) -> None:
    """Straight walkers have the better crowd score, and the lower walk score."""
    card = card_of(
        crowd("replay", "straight", ("replay", "straight")),
        crowd("replay", "theirs", ("replay", "recorded-paths")),
        crowd("replay", "recorded-paths", ("replay", "recorded-paths")),
    )
    out = printed(card, capsys)
    assert "1 rollout of each pair. Ranked by walk." in " ".join(out.split())
    first, second, third, *_ = lines_of(out)
    assert first.startswith(" replay × theirs ")
    assert first.endswith(" 1 ")
    assert second.startswith(" replay × straight ")
    assert second.endswith(" 2 ")
    assert third.startswith(" replay × recorded-paths ")
    assert third.endswith("  ")


def test_the_number_of_rollouts_is_that_of_each_row(capsys: Printed) -> None:
    pairs = [("poisson-gmm", "random"), ("replay", "random"), ("replay", "straight")]
    out = printed(card_of(crowd(*pairs[0]), *(ANCHORS[pair] for pair in pairs[1:])), capsys)
    assert "1 to 15 rollouts of each pair. Ranked by overall." in " ".join(out.split())
    for pair, number_made in zip(pairs, (15, 8, 1), strict=True):
        (line,) = [line for line in lines_of(out) if line.startswith(f" {' × '.join(pair)} ")]
        assert line.split()[3] == str(number_made)


def test_without_ranks_no_score_ranks(capsys: Printed) -> None:
    assert "Ranked by" not in printed(card_of(*map(unscored, USUAL.entries), rollouts=2), capsys)


def test_the_gate_says_limit_value_and_the_score_without_it(capsys: Printed) -> None:
    runner = msgspec.structs.replace(
        crowd("replay", "runner", ("replay", "recorded-paths")), speed_mps=2.0
    )
    out = " ".join(printed(card_of(runner, *USUAL.entries), capsys).split())
    standard = ANCHORS["replay", "recorded-paths"].speed_mps
    assert standard is not None
    without = ungated_walk(rows(card_of(runner, *USUAL.entries)))
    assert (
        f"runner does not pass the gate: mean speed 2.00 m/s, {100 * (2 / standard - 1):.1f} % "
        f"above that of recorded people walked ({standard:.2f} m/s; limit: 15 %). Therefore walk "
        f"is 0.00; without the gate, it would be {without}."
    ) in out
    assert "does not pass" not in printed(USUAL, capsys)


def ungated_walk(table: list[Row]) -> str:
    """The walk score of the policy `runner` by its families alone."""
    families = next(row.families for row in table if row.policy == "runner")
    return f"{min(families[name].value for name in WALK):.2f}"


def test_a_gate_that_changes_nothing_says_so(capsys: Printed) -> None:
    out = " ".join(printed(card_of(ANCHORS["replay", "random"], *USUAL.entries), capsys).split())
    assert "% at goal, which is " in out
    assert "limit: at least 95 %" in out
    assert "The gate does not change walk: it is −1.00 with and without it." in out
