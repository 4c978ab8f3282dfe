"""Sentences on a scorecard that the terminal and the report share: rollouts, and the gate."""

from collections.abc import Collection, Sequence

from crowdbench.report.display_names import Names
from crowdbench.report.text.words import number, share, speed
from crowdbench.scene import Gate
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import Limit, Row, Scorecard, gate_standard, walker_of


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
        exceeded = beyond_gate(
            row.fails,
            card.gate,
            speed_mps=walker.speed_mps,
            at_goal=walker.at_goal,
            recorded_speed_mps=standard.speed_mps,
            recorded_at_goal=standard.at_goal,
        )
        effect = effect_of_gate("walk", row.walk, row.walk_without_gate)
        notes.append(f"{names.policy[policy]} does not pass the gate: {exceeded}. {effect}")
    return notes


def beyond_gate(
    fails: Collection[Limit],
    gate: Gate,
    *,
    speed_mps: float | None,
    at_goal: float | None,
    recorded_speed_mps: float | None,
    recorded_at_goal: float | None,
) -> str:
    """The limits that a policy exceeds, with its values and those of recorded people walked."""
    found = []
    if "speed" in fails and recorded_speed_mps:
        off = (0.0 if speed_mps is None else speed_mps) / recorded_speed_mps - 1
        found.append(
            f"mean speed {speed(speed_mps)} m/s, {share(abs(off))} "
            f"{'above' if off > 0 else 'below'} that of recorded people walked "
            f"({speed(recorded_speed_mps)} m/s; limit: "
            f"{100 * gate.speed:g} %)"
        )
    if "arrivals" in fails and at_goal is not None and recorded_at_goal:
        found.append(
            f"{share(at_goal)} at goal, which is {share(at_goal / recorded_at_goal)} of the share "
            f"of recorded people walked ({share(recorded_at_goal)}; limit: at least "
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
