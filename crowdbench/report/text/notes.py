"""Sentences on a scorecard for the terminal and the report: rollouts, gate, missing scores."""

from collections.abc import Collection, Sequence

from crowdbench.metrics import METRICS, WALK, all_metrics
from crowdbench.report.display_names import Names
from crowdbench.report.text.words import STEERED, number, share, speed, to_import
from crowdbench.run.references import missing
from crowdbench.scene import Gate, Scene
from crowdbench.scoring.ceilings import read_ceilings
from crowdbench.scoring.ranking import Row, gate_standard, steered, walker_of
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import ANCHOR, Limit, Scorecard, has_recorded_arrivals
from crowdbench.spawn.names import replays


def made(card: Scorecard) -> str:
    """The numbers of rollouts of the pairs, as in `30 rollouts of each pair`."""
    numbers = [len(entry.seeds) for entry in card.entries]
    least, most = min(numbers), max(numbers)
    many = f"{most} rollout{'s' * (most != 1)}"
    folds = ", all folds together" if card.protocol == "heldout" else ""
    return f"{many if least == most else f'{least} to {many}'} of each pair{folds}"


def gate_notes(card: Scorecard, table: Sequence[Row], names: Names) -> list[str]:
    """A note on each evaluated policy that exceeds a limit of the scene's gate."""
    standard = gate_standard(card)
    first = {row.policy: row for row in reversed(table) if row.kind == "entry" and row.fails}
    notes = []
    for policy in dict.fromkeys(row.policy for row in table if row.policy in first):
        row, walker = first[policy], walker_of(card, policy)
        assert walker is not None  # it was judged
        speeds, shares = (walker.speed_mps, standard.speed_mps), (walker.at_goal, standard.at_goal)
        exceeded = beyond_gate(row.fails, card.gate, speeds, shares)
        effect = effect_of_gate("walk", row.walk, row.walk_without_gate)
        notes.append(f"{names.policy[policy]} does not pass the gate: {exceeded}. {effect}")
    return notes


def beyond_gate(
    fails: Collection[Limit],
    gate: Gate,
    speed_mps: tuple[float | None, float | None],
    at_goal: tuple[float | None, float | None],
) -> str:
    """The limits that a policy exceeds; each pair is its value and that of recorded people walked.

    The pairs are mean speeds in m/s, and shares of people at their goals.
    """
    found = []
    (mps, walked_mps), (arrived, walked_arrived) = speed_mps, at_goal
    if "speed" in fails and walked_mps:
        off = (0.0 if mps is None else mps) / walked_mps - 1
        found.append(
            f"mean speed {speed(mps)} m/s, {share(abs(off))} {'above' if off > 0 else 'below'} "
            f"that of recorded people walked ({speed(walked_mps)} m/s; limit: "
            f"{100 * gate.speed:g} %)"
        )
    if "arrivals" in fails and arrived is not None and walked_arrived:
        found.append(
            f"{share(arrived)} at goal, which is {share(arrived / walked_arrived)} of the share of "
            f"recorded people walked ({share(walked_arrived)}; limit: at least "
            f"{100 * gate.arrivals:g} %)"
        )
    return "; ".join(found)


def effect_of_gate(name: str, score: Score | None, without: Score | None) -> str:
    """What the gate does to the score `name` of a policy that exceeds a limit."""
    if score is None or without is None:
        return f"Therefore {name} is at most 0."
    if score.value == without.value:
        return f"The gate does not change {name}: it is {number(score)} with and without it."
    return f"Therefore {name} is {number(score)}; without the gate, it would be {number(without)}."


def score_notes(card: Scorecard, scene: Scene, table: Sequence[Row], names: Names) -> list[str]:
    """Explanations of a table of scores, and reasons why scores are missing."""
    notes = [
        f"Scores: 0 is the score of the anchor ({' × '.join(ANCHOR)}; for motion and interaction, "
        "straight walkers with the recorded arrivals), 1 the expected score of a perfect model. "
        "Brackets: 95 % intervals. crowd: mean of arrivals, presence, trips and space. walk: the "
        "lesser of motion and interaction. overall: mean of crowd and walk. –: nothing is scored. "
        "Crowds with equal ranks do not differ significantly (5 %, Holm). Unranked baselines "
        "follow: replay repeats the recording, recorded-paths walks it, block-replay repeats "
        "random blocks of it.",
        f"speed: mean of people who walk, m/s. at goal: share of people who reach it. walk is at "
        f"most 0 for policies marked with ! under the recorded arrivals: speed more than "
        f"{card.gate.speed:.0%} off that of recorded-paths, or less than {card.gate.arrivals:.0%} "
        "of its share at the goal.",
        *gate_notes(card, table, names),
    ]
    entries = [row for row in table if row.kind == "entry"]
    if not card.scored:
        notes.append(
            "No scores: this scene has no scored metrics yet. Run "
            f"`crowdbench scene power {scene.asked} --write`."
        )
    elif any((row.walk if replays(row.spawn) else row.crowd) is None for row in entries):
        notes.append(f"Scores are missing: {too_few_rollouts(card)}")
    if not has_recorded_arrivals(card):
        notes.append(f"Scores of motion and interaction need the recording: {to_import(scene)}.")
    notes += missing_notes(scene) + ceiling_notes([entry.spawn for entry in card.entries], scene)
    if any(steered(entry.spawn) for entry in card.entries):
        notes.append(STEERED)
    return notes


def ceiling_notes(arrivals: Collection[str], scene: Scene) -> list[str]:
    """What a right model would score in walking, under these spawn models; empty if unknown."""
    spawn = {name for name in arrivals if replays(name)}
    ceilings = read_ceilings(scene) if spawn and scene.protocol.scored else None
    if ceilings is None:
        return []
    of = ceilings.recorded if spawn == {"replay"} else ceilings.perturbed
    families = ", ".join(f"{name} {of.families[name]:.2f}" for name in WALK if name in of.families)
    return [
        f"In walking, a right model whose people act by chance would get about {of.walk:.2f} here "
        f"({families}): that is what {ceilings.policy} would get if the recording were one of its "
        "rollouts."
    ]


def too_few_rollouts(card: Scorecard) -> str:
    """How many rollouts scores need, and how many there are."""
    each = "" if card.fits == 1 else f"for each of the {card.fits} fits, that is, {2 * card.fits} "
    in_folds = " in each fold" if card.protocol == "heldout" else ""
    there = f"there {'is' if card.rollouts == 1 else 'are'} {card.rollouts}"
    return f"a score needs at least two rollouts {each}of each pair{in_folds}; {there}."


def missing_notes(scene: Scene) -> list[str]:
    """A note on registered metrics that could not be computed; empty if there are none."""
    absent = missing(scene) if len(all_metrics()) > len(METRICS) else []
    if not absent:
        return []
    return [f"{', '.join(absent)} can only be computed with the recording: {to_import(scene)}."]
