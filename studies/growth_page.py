"""The page of how cost grows: tables of `growth`, and what they mean for large studies."""

import os
from collections.abc import Iterator

from studies.growth import CITY_TITLE, Table, tables
from studies.markdown import flowed, table

INTRODUCTION = """# How cost grows

`python -m studies growth` measures these tables. They are from a machine with {cores} cores. All
figures but those of the table of threads are of one thread. A step is a step of the simulation and
the observation `social-1` of everyone. Agent-steps per second are the best of short measurements,
because other programs can only slow a measurement down. Compare only figures of the same run."""

WHY = {
    "People": """If cost grew faster than the number of people, agent-steps per second would fall.
Everyone looks for others in the cells around it, so that cost depends on the density, not on the
number of people: see the columns without boxes. Small worlds are slower, because each call of a
kernel has a fixed cost. With boxes, cost grows faster: here a larger world has more of them, and
whoever cannot see its target compares the ways around all corners.""",
    "Worlds": """A batch of worlds costs as much as the sum of its worlds. Few worlds are slower for
the same reason as few people.""",
    "Threads": """Threads share the people of a step and wait for each other at its end. Where other
programs use the processor, several threads can be slower than one. For many rollouts, use several
processes (`--workers`) instead.""",
    "Size": """The same people and walls in larger squares: people have fewer others in sight. Empty
space costs nothing but the memory of its cells.""",
    "Walls": """What people see of walls, and whether they walk into one, is looked up in cells:
that cost depends on the walls nearby. But whoever cannot see its target compares the ways around
all corners, four for each box. This cost is in proportion to the number of corners. Targets here
are far away, so most people do not see theirs.""",
    "Rollouts": """Rollouts are independent of each other, so their cost is the same however many
there are. Memory does not grow, because only statistics are kept.""",
    "A made-up": """10,000 people on the streets of a made-up city of 10 × 10 blocks of houses,
754 m wide, for 60 s. Its recording is another rollout of social forces.""",
}
OF_MODEL = 45
"""Rollouts of a model in a held-out evaluation: 15 in each of three folds."""


def page() -> Iterator[str]:
    """Parts of the page, as soon as they are measured."""
    yield flowed(INTRODUCTION.format(cores=os.cpu_count()))
    found = {}
    for measured in tables():
        found[measured.title] = measured
        why = next(text for start, text in WHY.items() if measured.title.startswith(start))
        yield flowed(f"## {measured.title}\n\n{why}\n\n{_table(measured)}")
    yield flowed(large_studies(found))


def _table(measured: Table) -> str:
    columns = list(measured.rows[0].figures)
    lines = [[row.size, *(_number(row.figures[c]) for c in columns)] for row in measured.rows]
    return table([measured.size, *columns], lines)


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def large_studies(found: dict[str, Table]) -> str:
    """What a million rollouts, a thousand scenes or long rollouts of a city would cost."""
    of_plaza = next(t for title, t in found.items() if title.startswith("Rollouts")).rows[-1]
    hours = of_plaza.figures["seconds per rollout"] / 3600
    stored = of_plaza.figures["MB stored per rollout"]
    of_city = found[CITY_TITLE].rows[-1].figures
    minute = (of_city["seconds to simulate"] + of_city["seconds to score"]) / 3600
    costs = [
        ("a million rollouts of a place like the plaza", 1e6 * hours, stored),
        (
            f"a thousand such places, ten models, {OF_MODEL} rollouts of each",
            1e4 * OF_MODEL * hours,
            1e-2 * OF_MODEL * stored,
        ),
    ]
    lines = [[what, _number(spent), _number(tb)] for what, spent, tb in costs]
    lines.append(["a thousand rollouts of the city, 60 s each", _number(1000 * minute), "–"])
    return f"""## Large studies

By these figures, rollouts with social forces, simulated and scored on cores like these, cost

{table(["study", "core-hours", "TB"], lines)}

Rollouts are independent of each other, so these hours can be divided among the cores of a
[cluster](cluster.md)."""
