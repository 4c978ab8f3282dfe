"""Diagrams of the documentation: SVG files that are readable on light and on dark pages.

Lengths are in pixels of the picture, y points down. Each picture has a card of its own as
background, because a page may be dark where the reader's system is light.
"""

from collections.abc import Callable, Iterable, Sequence
from html import escape
from itertools import combinations
from math import atan2, cos, dist, radians, sin
from pathlib import Path

from crowdbench.data.blocks import FOLDS, SPLITS
from crowdbench.files import write_text
from crowdbench.simulation.social import NEAREST, PROBE_POINTS, RANGE_M

Point = tuple[float, float]

_STYLE = """
text { font: 14px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; fill: #1f2328 }
.card { fill: #ffffff } .box { fill: #f3f5f8; stroke: #818b98 }
.soft { fill: #59636e } text.soft { font-size: 12px } .bold { font-weight: 600 }
.line { fill: none; stroke: #59636e; stroke-width: 1.5 } .head { fill: #59636e }
.thin { fill: none; stroke: #818b98; stroke-dasharray: 4 4 } .wall { fill: #b6bec8 }
.a { fill: #0072b2; stroke: #0072b2 } .b { fill: #d55e00; stroke: #d55e00 }
.c { fill: #008560; stroke: #008560 } .d { fill: #818b98; stroke: #818b98 }
.a.open, .b.open, .c.open { fill: none; stroke-width: 1.5 } text.a, text.b, text.c { stroke: none }
text.on { fill: #ffffff }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f6fc } .card { fill: #0d1117 } .box { fill: #1c232c; stroke: #6e7681 }
  .soft { fill: #a5afba } .line { stroke: #a5afba } .head { fill: #a5afba }
  .thin { stroke: #6e7681 } .wall { fill: #444c56 }
  .a { fill: #58b4ec; stroke: #58b4ec } .b { fill: #ff9b4a; stroke: #ff9b4a }
  .c { fill: #3ecf9c; stroke: #3ecf9c } .d { fill: #8b949e; stroke: #8b949e }
  text.on { fill: #0d1117 }
}"""


def write_diagrams(folder: Path) -> list[Path]:
    """Write all diagrams to a folder, the same bytes each time; their files."""
    paths = []
    for name, draw in DIAGRAMS.items():
        paths.append(folder / f"{name}.svg")
        write_text(paths[-1], draw())
    return paths


def concepts() -> str:
    """Scene, spawn model, policy, crowd and score."""
    parts = _box(
        20,
        24,
        195,
        100,
        ("Scene", "bounds, walls, areas where", "people enter and leave,", "rules of motion"),
    )
    parts += _box(20, 184, 195, 76, ("Recording", "the people who were", "there"))
    parts += _box(
        265, 24, 195, 76, ("Spawn model", "who enters, when, where,", "with which goal and speed")
    )
    parts += _box(265, 184, 195, 76, ("Policy", "how each person walks:", "observation → action"))
    parts += _box(510, 104, 165, 76, ("Crowd", "paths of simulated", "people"))
    parts += _box(725, 104, 165, 76, ("Score", "1: like the recording", "0: the simple baseline"))
    parts.append(_arrow((215, 62), (265, 62)))
    parts.append(_arrow((460, 62), (485, 62), (485, 130), (510, 130)))
    parts.append(_arrow((460, 222), (485, 222), (485, 154), (510, 154)))
    parts.append(_arrow((675, 142), (725, 142)))
    parts.append(_arrow((117, 184), (117, 124)))
    parts.append(_text(127, 158, "areas and speeds", "soft", "start"))
    parts.append(_arrow((117, 260), (117, 284), (807, 284), (807, 180)))
    parts.append(_text(462, 279, "the same metrics of both", "soft"))
    return _svg(910, 304, "Scene, spawn model, policy, crowd and score", parts)


def step() -> str:
    """The order of a step, and the stages of a person."""
    order = (
        ("1. Everyone moves", "as the policy asks;", "walls stop people"),
        ("2. Trips end", "at the goal, outside the", "bounds, or after too long"),
        ("3. People enter", "if their time has come", "and there is room"),
        ("4. Everyone gets", "an observation", "and a reward"),
    )
    stages = (
        ("Waits to enter", "while somebody is", "closer than 0.3 m"),
        ("Walks to via point", "the target is", "the via point"),
        ("Waits there", "the policy decides", "whether to stand"),
        ("Walks to its goal", "the target is", "the goal"),
        ("Trip ends", "goal, exit,", "timeout or horizon"),
    )
    parts = [_text(20, 34, "What happens in a step", "bold", "start")]
    for k, lines in enumerate(order):
        parts += _box(20 + 215 * k, 50, 185, 76, lines)
        if k < 3:
            parts.append(_arrow((205 + 215 * k, 88), (235 + 215 * k, 88)))
    parts.append(_arrow((757, 126), (757, 152), (112, 152), (112, 126)))
    parts.append(_text(435, 147, "the policy chooses the next actions", "soft"))
    parts.append(_text(20, 204, "The stages of a person", "bold", "start"))
    for k, lines in enumerate(stages):
        parts += _box(20 + 173 * k, 250, 153, 76, lines)
        if k < 4:
            parts.append(_arrow((173 + 173 * k, 288), (193 + 173 * k, 288)))
    parts.append(_arrow((96, 250), (96, 228), (585, 228), (585, 250)))
    parts.append(_text(340, 223, "without a via point", "soft"))
    parts.append(_arrow((269, 326), (269, 350), (615, 350), (615, 326)))
    parts.append(_text(442, 345, "gives the via point up: 30 s without coming closer", "soft"))
    return _svg(885, 370, "A step, and the stages of a person", parts)


def social() -> str:
    """The own frame of the observation `social-1`: probes of free space, and the nearest people."""
    per_m, centre, heading = 34.0, (230.0, 260.0), radians(25)

    def at(ahead: float, left: float) -> Point:
        """Place in the picture of a point in the own frame, in metres."""
        x = ahead * cos(heading) - left * sin(heading)
        y = ahead * sin(heading) + left * cos(heading)
        return centre[0] + per_m * x, centre[1] - per_m * y

    people = (  # offset in m, velocity in m/s, class
        ((3.6, 1.5), (-1.4, -0.3), "b"),
        ((-2.6, -2.8), (1.2, 0.6), "b"),
        ((0.3, 1.3), (1.3, 0.0), "c"),
        ((4.6, 4.6), (-1.0, 0.4), "d"),
    )
    wall = " ".join(map(_pair, (at(2.4, -1.7), at(5.6, -1.7), at(5.6, -4.0), at(2.4, -4.0))))
    target = at(4.6, -4.9)
    parts = [
        f'<circle class="thin" {_xy("c", centre)} r="{_n(RANGE_M * per_m)}"/>',
        f'<polygon class="wall" points="{wall}"/>',
        _text(*at(4.0, -3.0), "wall"),
        _arrow(centre, at(4.4, 0.0)),
        _text(*at(4.75, 0.0), "x", "bold"),
        _arrow(centre, at(0.0, 2.8)),
        _text(*at(0.0, 3.1), "y", "bold"),
        _line(centre, at(2.2, -4.2), "a open"),
        _line(at(2.2, -4.2), target, "a open"),
        _square(target, 12, "a open"),
        _text(target[0] + 12, target[1] + 5, "target", "", "start"),
    ]
    parts += [_disc(at(*point), 2.4, "d") for point in PROBE_POINTS]
    for offset, velocity, kind in people:
        there = (offset[0] + velocity[0], offset[1] + velocity[1])
        parts += [_disc(at(*offset), 0.3 * per_m, kind), _arrow(at(*offset), at(*there))]
    parts.append(_disc(centre, 0.3 * per_m, "a"))
    parts += [_arrow((40, 490), (90, 490)), _arrow((40, 490), (40, 440))]
    parts += [_text(100, 495, "east", "soft", "start"), _text(40, 432, "north", "soft")]
    legend = (
        ("a", 8, "the person itself; x is its heading, y its left"),
        ("d", 3, f"{len(PROBE_POINTS)} probes: the free space around each point"),
        ("b", 8, f"the {NEAREST} nearest people within {RANGE_M:g} m (dashed)"),
        ("c", 8, "one of them who is a companion"),
        ("d", 8, "too far away: not seen"),
    )
    for k, (kind, radius, words) in enumerate(legend):
        parts.append(_disc((530, 90 + 32 * k), radius, kind))
        parts.append(_text(550, 95 + 32 * k, words, "", "start"))
    notes = (
        "Arrows at people are their velocities.",
        "Each neighbour has an offset and a relative velocity in",
        "this frame, and the time and distance of the closest",
        "approach if both keep their velocities.",
        "The route leads around walls: the person sees the",
        "direction of its next corner, and its length.",
        "Actions are in this frame, too: (0.26, 0) is straight on",
        "at 1.3 m/s, where the maximum speed is 5 m/s.",
    )
    parts += [_text(522, 275 + 22 * k, words, "soft", "start") for k, words in enumerate(notes)]
    return _svg(900, 510, "The frame of the observation social-1", parts)


def splits() -> str:
    """Time blocks, folds and splits; fits and rollouts of a split."""
    blocks, fits, rollouts, wide = 12, 5, 10, 48
    kinds = ("a", "b", "c")
    parts = [_text(20, 34, "Blocks of the recording, dealt into three folds", "bold", "start")]
    for k in range(blocks):
        fold = k % FOLDS
        parts += _cell(150 + wide * k, 48, wide - 4, 30, kinds[fold], f"fold {fold}", full=True)
    parts.append(_text(20, 68, "time →", "soft", "start"))
    parts.append(
        _text(20, 120, "Each split trains on some blocks and is scored on others", "bold", "start")
    )
    for row, split in enumerate(SPLITS):
        y = 134 + 38 * row
        parts.append(_text(20, y + 20, split, "", "start"))
        for k in range(blocks):
            scored = k % FOLDS == row - 1
            words = "both" if row == 0 else "score" if scored else "train"
            kind = kinds[k % FOLDS]
            parts += _cell(150 + wide * k, y, wide - 4, 30, kind, words, full=not scored)
    parts.append(
        _text(
            20,
            326,
            "Each split has five fits; rollout k uses fit k mod 5, and seed k",
            "bold",
            "start",
        )
    )
    for k in range(fits):
        x = 150 + 116 * k
        parts += _box(x, 342, 100, 34, (f"fit {k}",))
        for below, rollout in enumerate(range(k, rollouts, fits)):
            parts += _cell(x, 402 + 32 * below, 100, 26, "d", f"rollout {rollout}", full=False)
        parts.append(_arrow((x + 50, 376), (x + 50, 400)))
    parts.append(_text(20, 364, "training", "soft", "start"))
    parts.append(_text(20, 420, "simulation", "soft", "start"))
    return _svg(750, 482, "Split, fold, fit and seed", parts)


def score() -> str:
    """Energy scores of a model and of the anchor, and how they become scores."""
    recording = (190.0, 215.0)
    crowds = {  # one point for each rollout
        "d": [(150.0, 175.0), (250.0, 190.0), (160.0, 265.0), (235.0, 260.0), (120.0, 225.0)],
        "a": [(255.0, 130.0), (318.0, 185.0), (225.0, 85.0), (290.0, 250.0)],
        "b": [(330.0, 345.0), (352.0, 362.0), (322.0, 371.0), (346.0, 335.0)],
    }
    floor_, model, anchor = (energy_score(points, recording) for points in crowds.values())
    value = 1 - (model - floor_) / (anchor - floor_)
    parts = [_text(20, 34, "Each point is a crowd", "bold", "start")]
    parts += [_line(recording, point, "a open") for point in crowds["a"]]
    parts += [_line(*pair, "thin") for pair in combinations(crowds["a"], 2)]
    for kind, points in crowds.items():
        parts += [_disc(point, 5, kind) for point in points]
    parts += [
        _square(recording, 15, "card"),
        _square(recording, 14, "line"),
        _text(190, 246, "recording y"),
        _text(330, 118, "rollouts of a model", "a", "start"),
        _text(330, 138, "lines: d(X, y), dashed: d(X, X′)", "soft", "start"),
        _text(40, 300, "other recordings of the same place", "soft", "start"),
        _text(338, 398, "rollouts of the anchor: too far, too alike", "b"),
    ]
    top, bottom, x = 110.0, 350.0, 640.0
    parts += [
        _text(560, 34, "The scale", "bold", "start"),
        _text(x - 16, 62, "energy score ES", "soft", "end"),
        _text(x + 16, 62, "score S", "soft", "start"),
        _line((x, top - 30), (x, bottom + 30), "line"),
    ]
    for kind, name, es, shown in (
        ("d", "noise floor F", floor_, "1: a perfect model"),
        ("a", "this model", model, f"{value:.2f}"),
        ("b", "anchor", anchor, "0"),
    ):
        y = top + (bottom - top) * (es - floor_) / (anchor - floor_)
        parts += [_disc((x, y), 6, kind), _text(x - 16, y + 5, name, "", "end")]
        parts.append(_text(x + 16, y + 5, shown, "bold", "start"))
    parts.append(_text(640, 410, "ES = mean d(X, y) − ½ mean d(X, X′)", "soft"))
    return _svg(830, 430, "Energy score, noise floor, anchor and score", parts)


def energy_score(crowd: Sequence[Point], recording: Point) -> float:
    """Mean distance of the points to the recording, minus half the mean distance between two."""
    apart = [dist(*pair) for pair in combinations(crowd, 2)]
    to_y = [dist(point, recording) for point in crowd]
    return sum(to_y) / len(to_y) - sum(apart) / len(apart) / 2


def submission() -> str:
    """The way of a submission to the pages of the leaderboard."""
    rows = (
        (
            "You",
            ("A folder", "submission.toml and", "networks or fits"),
            ("Check", "lists all problems", "at once"),
            ("Pull request", "adds the folder as", "leaderboard/submissions/ID"),
        ),
        (
            "The workflow",
            ("Check", "again, with the code", "of the target branch"),
            ("Verify in a sandbox", "rollouts with crowdbench's", "seeds, then scores"),
            ("Entry", "scores, intervals, flags;", "an artifact of the run"),
        ),
        (
            "A maintainer",
            ("Review", "nothing but the folder", "is changed"),
            ("Entry into entries/", "the folder stays in", "the repository"),
            ("Pages", "ranks, tables,", "plots"),
        ),
    )
    parts = []
    for row, (who, *boxes) in enumerate(rows):
        y = 24 + 122 * row
        parts.append(_text(20, y + 43, who, "bold", "start"))
        for k, lines in enumerate(boxes):
            parts += _box(140 + 245 * k, y, 210, 76, lines)
            if k < 2:
                parts.append(_arrow((350 + 245 * k, y + 38), (385 + 245 * k, y + 38)))
        if row < 2:
            parts.append(_arrow((735, y + 76), (735, y + 99), (245, y + 99), (245, y + 122)))
    return _svg(860, 362, "The way of a submission", parts)


DIAGRAMS: dict[str, Callable[[], str]] = {
    "concepts": concepts,
    "step": step,
    "social-1": social,
    "splits": splits,
    "score": score,
    "submission": submission,
}
"""Functions that return a diagram, by the name of its file."""


def _svg(width: int, height: int, title: str, parts: Iterable[str]) -> str:
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" role="img">',
            f"<title>{escape(title)}</title>\n<style>{_STYLE}\n</style>",
            f'<rect class="card" width="{width}" height="{height}" rx="8"/>',
            *parts,
            "</svg>\n",
        )
    )


def _n(number: float) -> str:
    return f"{number:.1f}".removesuffix(".0")


def _pair(point: Point) -> str:
    return f"{_n(point[0])},{_n(point[1])}"


def _xy(before: str, point: Point) -> str:
    return f'{before}x="{_n(point[0])}" {before}y="{_n(point[1])}"'


def _text(x: float, y: float, words: str, kind: str = "", anchor: str = "middle") -> str:
    where = f'{_xy("", (x, y))} text-anchor="{anchor}"'
    return f'<text {where} class="{kind}">{escape(words)}</text>'


def _box(x: float, y: float, width: float, height: float, lines: Sequence[str]) -> list[str]:
    """A box with a title and further lines."""
    size = f'{_xy("", (x, y))} width="{_n(width)}" height="{_n(height)}"'
    first = y + height / 2 + 5 - 9.5 * (len(lines) - 1)
    words = [
        _text(x + width / 2, first + 19 * k, line, "soft" if k else "bold")
        for k, line in enumerate(lines)
    ]
    return [f'<rect class="box" {size} rx="6"/>', *words]


def _cell(
    x: float, y: float, width: float, height: float, kind: str, words: str, *, full: bool
) -> list[str]:
    """A small coloured rectangle with a word, filled or only outlined."""
    size = f'{_xy("", (x, y))} width="{_n(width)}" height="{_n(height)}"'
    shown = kind if full else "line" if kind == "d" else f"{kind} open"
    word = _text(x + width / 2, y + height / 2 + 4.5, words, "soft on" if full else "soft")
    return [f'<rect class="{shown}" {size} rx="3"/>', word]


def _square(at: Point, side: float, kind: str) -> str:
    corner = _xy("", (at[0] - side / 2, at[1] - side / 2))
    return f'<rect class="{kind}" {corner} width="{_n(side)}" height="{_n(side)}"/>'


def _disc(at: Point, radius: float, kind: str) -> str:
    return f'<circle class="{kind}" {_xy("c", at)} r="{_n(radius)}"/>'


def _line(start: Point, end: Point, kind: str) -> str:
    return f'<path class="{kind}" d="M {_pair(start)} L {_pair(end)}"/>'


def _arrow(*points: Point) -> str:
    """A line through points, with a head at the last one."""
    (x0, y0), (x, y) = points[-2:]
    angle = atan2(y - y0, x - x0)
    corners = [(x + 9 * cos(angle + turn), y + 9 * sin(angle + turn)) for turn in (2.7, -2.7)]
    head = " ".join(map(_pair, [(x, y), *corners]))
    path = " L ".join(map(_pair, points))
    return f'<path class="line" d="M {path}"/><polygon class="head" points="{head}"/>'
