"""The page of controllers of robots among people of several kinds."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

from crowdbench.robot.comparison import COLUMNS, Comparison, compare
from crowdbench.robot.controllers import list_controllers
from crowdbench.robot.statistics import Estimate
from crowdbench.scene import load_scene
from studies.markdown import flowed, table
from studies.robot_pictures import write_pictures

SCENE = "eth-v0"
WALKERS = ("straight", "social-force", "replay", "anticipate")
PEOPLE = {
    "straight": "who see nobody",
    "social-force": "driven by social forces",
    "replay": "as recorded",
    "anticipate": "of the network `anticipate`",
}
"""What people of each kind are like."""
TITLE = """# The table of robots

The robot `{robot}` crosses `{scene}` by {controllers} controllers, among people of {kinds} kinds.
Each cell of the first table is the share of {episodes} episodes in which the robot reached its
goal without a contact, with its 95 % interval, and the controller's rank in that column.
Controllers share a rank unless they differ significantly. [Robots](robots.md) explains controllers
and measures.
People enter as `{spawn}` says, those who walk as recorded also when they were recorded.

![shares of success](robots/success.png)

{finding}

No controller has seen the arrivals of the table: those that `ppo` learned from were drawn with
other seeds, from 1,000,000 on, of a model that was fitted to the whole recording. Nothing of the
other controllers is fitted.

This page is the output of `python -m studies robots`."""


EPISODE = flowed("""## One episode

![one episode](robots/episode.png)

The same episode by each controller, among people driven by social forces, at its end. The way of
the robot begins at the ring, and its goal is the green circle. Black lines lead to where people
will be in a second.
""")


def page(
    episodes: int, scene: str = SCENE, workers: int | None = None, pictures: Path | None = None
) -> str:
    """The page as Markdown; its pictures are written into the folder `pictures`."""
    controllers = list_controllers(load_scene(scene))
    found = {
        walkers: compare(
            scene, controllers, walkers=walkers, episodes=episodes, workers=workers,
            costs=walkers != "replay",
        )
        for walkers in WALKERS
    }  # fmt: skip
    first = found["straight"]
    title = TITLE.format(
        robot=first.robot,
        scene=first.scene,
        controllers=_word(len(controllers)),
        kinds=_word(len(WALKERS)),
        episodes=episodes,
        spawn=first.spawn,
        finding=finding({name: ranks_of(of) for name, of in found.items()}),
    )
    head = ["controller", *(f"people {PEOPLE[name]}" for name in found)]
    lines = [
        [name, *(_success(of, k) for of in found.values())] for k, name in enumerate(controllers)
    ]
    if pictures is not None:
        write_pictures(pictures, found, PEOPLE, load_scene(scene))
    rooms = "\n\n".join(_people(name, of) for name, of in found.items())
    return f"{flowed(title)}\n{table(head, lines)}\n\n{EPISODE}\n{rooms}\n"


def ranks_of(comparison: Comparison) -> dict[str, int]:
    """The rank of each controller."""
    return {of.controller: of.rank for of in comparison.results}


def finding(ranks: Mapping[str, Mapping[str, int]]) -> str:
    """What the ranks among people of several kinds say about ranking robots.

    `ranks` maps kinds of people to the ranks of controllers.
    """
    names = list(next(iter(ranks.values())))
    pairs = list(combinations(names, 2))
    orders = {
        f"{a}–{b}": {(of[a] > of[b]) - (of[a] < of[b]) for of in ranks.values()} for a, b in pairs
    }
    turned = [pair for pair, found in orders.items() if {-1, 1} <= found]
    tied = [pair for pair, found in orders.items() if len(found) > 1 and pair not in turned]
    sentences = [f"**What it says.** {_first(ranks)}"]
    if turned:
        which = "This pair changes its" if len(turned) == 1 else "These pairs change their"
        sentences.append(f"{which} order with the people: {_listed(turned)}.")
    if tied:
        some = f"{_word(len(tied)).capitalize()} of {len(pairs)} pairs"
        verb = "differs" if len(tied) == 1 else "differ"
        sentences.append(f"{some} {verb} significantly among some people only.")
    same = "The ranks are the same among all people."
    only = "So a ranking of robots holds for the people that it was measured among."
    return " ".join([*sentences, only if turned or tied else same])


def _first(ranks: Mapping[str, Mapping[str, int]]) -> str:
    """Who ranks first among people of each kind, as a sentence."""
    best = {
        kind: _listed([name for name, rank in of.items() if rank == 1])
        for kind, of in ranks.items()
    }
    if len(set(best.values())) == 1:
        return f"Among people of all kinds, {next(iter(best.values()))} come first."
    firsts = "; ".join(f"{who} among people {PEOPLE[kind]}" for kind, who in best.items())
    return f"Who comes first depends on the people: {firsts}."


def _people(name: str, comparison: Comparison) -> str:
    shown = [key for key in COLUMNS if key in comparison.results[0].measures]
    lines = [
        [of.controller, str(of.rank), *(_number(of.measures[key], key) for key in shown)]
        for of in comparison.results
    ]
    head = ["controller", "rank", *(COLUMNS[key] for key in shown)]
    return f"## Among people {PEOPLE[name]}\n\n{table(head, lines)}"


def _success(comparison: Comparison, k: int) -> str:
    result = comparison.results[k]
    of = result.measures["success"]
    return f"{of.value:.2f} [{of.low:.2f}, {of.high:.2f}], {result.rank}"


def _number(of: Estimate, name: str) -> str:
    if of.value is None:
        return "–"
    return f"{of.value:.{1 if name.endswith('time_s') else 2}f}"


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _word(number: int) -> str:
    words = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[number] if number < len(words) else str(number)
