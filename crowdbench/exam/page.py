"""The page of an exam: a table of all tests, and pictures of the rooms with their flows."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from crowdbench.colours import COLOURS
from crowdbench.data.table import Trajectories
from crowdbench.exam.measures import crossed_s, left_s
from crowdbench.exam.results import Certificate, Measured, TrialResult
from crowdbench.exam.rooms import Room
from crowdbench.exam.trial import NOT_APPLICABLE, TRIALS
from crowdbench.files import replacing, write_json
from crowdbench.report.html.render import html, html_page
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.flow import DENSEST_PER_M2, weidmann

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DENSITY = re.compile(r"speed at ([0-9.]+) per (m²|m), m/s=([0-9.]+)")
MOST_PATHS = 80
"""Number of people whose paths a picture shows."""
_STYLE = """
td.failed b { color: #b00020; } td b { display: block; }
td, th { text-align: left; } .rooms { display: grid; gap: 0.8rem;
grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
figure { margin: 0; } img { width: 100%; height: auto; background: #fff; }
figcaption { font-size: 0.85rem; }
"""

Shown = Mapping[tuple[str, str], tuple[Room, Trajectories]]
"""The room of a policy and a test, and what happened in it with the first seed."""


def write_exam(certificates: Sequence[Certificate], shown: Shown, folder: Path) -> None:
    """Write `exam.html` and `exam.json` to a folder."""
    write_json(folder / "exam.json", list(certificates))
    pictures = {
        of.id: [
            (
                one.policy,
                _address(*shown[one.policy, of.id], one.tests[k]),
                _verdict(one.tests[k]),
            )
            for one in certificates
        ]
        for k, of in enumerate(certificates[0].tests)
    }
    body = html(
        "exam.html.j2",
        certificates=certificates,
        trials=[TRIALS[of.id] for of in certificates[0].tests],
        by_id=[{of.id: of for of in one.tests} for one in certificates],
        not_applicable=NOT_APPLICABLE,
        pictures=pictures,
        value=written,
    )
    with replacing(folder / "exam.html") as path:
        path.write_text(html_page("Exam", body, style=_STYLE), encoding="utf-8")


def written(measured: Measured) -> str:
    """A measured value as text, with its range over the seeds if they differ."""
    mean, low, high = (
        "never" if value is None else f"{round(value, 3) + 0.0:.3g}"
        for value in (measured.mean, measured.low, measured.high)
    )
    return mean if low == high or "never" in (low, mean) else f"{mean} [{low}, {high}]"


def _verdict(result: TrialResult) -> str:
    return "passed" if result.passed else "failed"


def _address(room: Room, crowd: Trajectories, result: TrialResult) -> Markup:
    def draw(axes: "list[Axes]") -> None:
        draw_room(axes[0], room, crowd)
        speeds = _DENSITY.findall(" ".join(f"{of.name}={of.mean}" for of in result.measured))
        if speeds:
            draw_diagram(axes[1], [(float(d), float(v)) for d, _, v in speeds], unit=speeds[0][1])
        else:
            draw_times(axes[1], room, crowd)

    data = picture(draw, width=6.0, height=2.6, columns=2, kind="small png", shared=False)
    return Markup(f"data:image/png;base64,{b64encode(data).decode()}")


def draw_room(plan: "Axes", room: Room, crowd: Trajectories) -> None:
    """Draw a room with the paths of its people."""
    for wall in room.scene.walls:
        plan.fill(*np.array(wall.corners_m).T, color="#8a8f98", linewidth=0)
    chosen = np.linspace(0, len(crowd) - 1, min(len(crowd), MOST_PATHS)).round().astype(int)
    for p in chosen.tolist():
        path = crowd.path(p)
        plan.plot(*path.T, color=COLOURS[0], alpha=0.35, linewidth=0.6)
    plan.plot(*crowd.start[chosen].T, ".", color=COLOURS[1], markersize=2)
    if room.line is not None:
        plan.plot(room.line[::2], room.line[1::2], color=COLOURS[2], linewidth=1.5)
    plan.set(aspect="equal", xlabel="x, m", ylabel="y, m")


def draw_times(curve: "Axes", room: Room, crowd: Trajectories) -> None:
    """Draw how many people have passed the line of a room, or have left it, over time."""
    times = left_s(crowd) if room.line is None else crossed_s(crowd, room.line)
    times = np.sort(times[np.isfinite(times)])
    count = np.arange(1, len(times) + 1)
    curve.step(np.r_[0.0, times], np.r_[0, count], where="post", color=COLOURS[0])
    what = "have left" if room.line is None else "have passed the line"
    curve.set(xlabel="time, s", ylabel=what, ylim=(0, len(crowd) * 1.05), xlim=(0, None))


def draw_diagram(curve: "Axes", speeds: Sequence[tuple[float, float]], *, unit: str) -> None:
    """Draw a fundamental diagram: speeds in m/s by density, beside Weidmann's if it is per m²."""
    curve.plot(*np.array(speeds).T, "o-", color=COLOURS[0], markersize=3)
    if unit == "m²":
        density = np.linspace(0.1, DENSEST_PER_M2, 100)
        curve.plot(density, weidmann(density), "--", color="0.35", label="Weidmann (1993)")
        curve.legend()
    curve.set(xlabel=f"density, persons per {unit}", ylabel="speed, m/s", ylim=(0, None))
