"""The report's pictures: small panels that stand side by side or below each other.

Each panel is a picture of its own, about as wide as a phone, so that its letters are legible on
one; what the lines mean is said once, in text, above the panels.
"""

from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np

from crowdbench.colours import COLOURS
from crowdbench.report.plots import PlotData, panels, picture
from crowdbench.report.plots.plot_data import Curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 4.2
_MOST_AREAS = 12
_LEAST_GAPS = 20


def pictures(plot: PlotData) -> str:
    """All sections of pictures."""
    if not plot.groups:
        return "<p>There is no rollout to draw.</p>"
    rollouts = max(len(group.crowds) for group in plot.groups)
    fold = " of the first fold, in its time blocks" if plot.part != "full" else ""
    many = f"{rollouts} rollouts" if rollouts > 1 else "one rollout"
    return "\n".join(
        [
            f"<p>They show {many} of each crowd{fold}. Colours are spawn models, dashes are "
            "policies, the recording is black or grey. Pictures describe; scores judge.</p>",
            _section("Agents over time", _over_time(plot), "wide", lead=_bands(plot)),
            _section(
                "Distributions",
                _distributions(plot),
                "wide",
                lead=f'{_key(plot)}<p class="note">Curves show the share of values above x. Where '
                "a crowd’s curve stays in the grey band, the recording is too short to tell them "
                "apart there.</p>",
            ),
            _section(
                "Gaps between arrivals at each spawn area",
                _per_area(plot),
                "small",
                lead=f"{_key(plot)}{_which_areas(plot)}",
            ),
            _section("From where to where", _flows(plot), "maps", lead=_areas_key(flows=True)),
            _section(
                "Where people spend their time",
                _occupancy(plot),
                "maps",
                lead='<p class="note">Share of all people’s time in each square metre, the same '
                "scale everywhere; brighter is more, white is never.</p>",
            ),
            _section("Paths of one rollout", _paths(plot), "maps", lead=_areas_key(flows=False)),
        ]
    )


def _bands(plot: PlotData) -> str:
    """What black, grey and thin lines mean where agents are drawn over time."""
    mean = '<span class="mean"></span> recorded: mean N of a time block'
    band = '<span class="band"></span> recorded: what N lies between for 90 % of a time block'
    thin = "thin lines: rollouts, one of them drawn out; where only they are drawn, the recording "
    thin += "is not compared"
    if panels.in_blocks(plot):
        keys = [mean, f"{thin}; of a recording as long as this they are drawn by such means too"]
    else:
        keys = [band, '<span class="mean"></span> its mean', thin]
    return f'<ul class="key">{"".join(f"<li>{key}</li>" for key in keys)}</ul>'


def _section(title: str, figures: Sequence[str], kind: str = "", *, lead: str = "") -> str:
    grid = f"panels {kind}".strip()
    return f'<h3>{title}</h3>\n{lead}\n<div class="{grid}">\n{"".join(figures)}</div>'


def _figure(
    draw: Callable[["Axes"], None],
    *,
    caption: str,
    alt: str,
    height: float,
    width: float = _WIDTH,
    kind: Literal["small png", "svg"] = "svg",
) -> str:
    data = picture(lambda axes: draw(axes[0]), width=width, height=height, kind=kind)
    mime = "image/svg+xml" if kind == "svg" else "image/png"
    return (
        f"<figure><figcaption>{caption}</figcaption>"
        f'<img src="data:{mime};base64,{b64encode(data).decode()}" alt="{escape(alt)}" '
        f'width="{96 * width:.0f}" height="{96 * height:.0f}"></figure>\n'
    )


def _sample(colour: str, dashes: Sequence[float], thick: float = 2.0) -> str:
    # matplotlib's dashes are in units of the line's width.
    pattern = " ".join(f"{thick * d:g}" for d in dashes)
    dashed = f' stroke-dasharray="{pattern}"' if pattern else ""
    return (
        f'<svg width="36" height="10" aria-hidden="true"><path d="M1 5H35" stroke="{colour}" '
        f'stroke-width="{thick:g}"{dashed} fill="none"/></svg>'
    )


def _key(plot: PlotData) -> str:
    items = [f"<li>{_sample('currentColor', (), 3.0)} recorded</li>"]
    items.append('<li><span class="band"></span> recorded, 95 % by resampling time blocks</li>')
    items += [f"<li>{_sample(g.colour, g.dashes)} {escape(g.label)}</li>" for g in plot.groups]
    return f'<ul class="key">{"".join(items)}</ul>'


def _areas_key(*, flows: bool) -> str:
    goals = (
        "<li>arrows: from a spawn area to a goal area (dot), as wide as the share of people who "
        f"walk there, from {100 * panels.LEAST_SHARE:.0f} % on; a colour per goal area; a ring: "
        "back to where they came from</li>"
        if flows
        else f"<li>{_sample(COLOURS[0], ())} goal area, two standard deviations, and paths to it "
        "in its colour</li>"
    )
    return (
        f'<ul class="key"><li>{_sample("currentColor", (5.0, 2.0), 1.2)} spawn area, two standard '
        f'deviations</li>{goals}<li><span class="band wall"></span> wall</li></ul>'
    )


def _over_time(plot: PlotData) -> list[str]:
    found = []
    for group in plot.groups:
        present = np.concatenate([crowd.present() for crowd in group.crowds])
        count = len(group.crowds)
        found.append(
            _figure(
                partial(panels.agents_over_time, plot=plot, group=group),
                caption=f"<b>{escape(group.label)}</b>, {count} rollout{'s' * (count > 1)}",
                alt=f"Number of agents over time in rollouts of {group.label}: mean "
                f"{present.mean():.1f}, at most {present.max()}.",
                width=4.6,
                height=2.3,
                kind="small png",
            )
        )
    return found


def _distributions(plot: PlotData) -> list[str]:
    scene = plot.scene
    found = []
    for name, title, what, unit in (
        ("inter_spawn", "Inter-spawn time", "time between two arrivals (s)", scene.grid_s),
        ("spawns_per_10_frames", "Spawns per 10 frames",
         f"people who enter in {10 * scene.dt_s:.3g} s", 1.0),
        ("agents_over_time", "Agents present, N(t)", "agents present", 1.0),
        ("dwell", "Dwell time", "time from entering to leaving (s)", scene.dt_s),
    ):  # fmt: skip
        curves = plot.curves(name)

        cut_off = name == "dwell" and panels.patience_s(plot) < curves.longest() * unit
        cut = "; dotted: simulated lives are cut off" if cut_off else ""
        found.append(
            _figure(
                partial(
                    _distribution,
                    plot=plot,
                    name=name,
                    curves=curves,
                    unit=unit,
                    what=what,
                ),
                caption=f"<b>{title}</b>{cut}",
                alt=f"Survival curves, {title.lower()}. {medians(plot, curves, unit)}",
                width=4.6,
                height=2.7,
            )
        )
    return found


def _distribution(
    axis: "Axes", plot: PlotData, name: str, curves: Curves, unit: float, what: str
) -> None:
    panels.survival(axis, plot, curves, unit=unit, what=what)
    if name == "dwell":
        panels.patience(axis, plot)


def medians(plot: PlotData, curves: Curves, unit: float, area: int = 0) -> str:
    """The medians of a metric's distributions, recorded and of each group."""
    each = [curves.recorded[area], *curves.groups[:, area]]
    labels = ["recorded", *(group.label for group in plot.groups)]
    # The last value of a distribution function is 1 but for rounding.
    middle = [curves.support[min(int(np.searchsorted(f, 0.5)), len(f) - 1)] * unit for f in each]
    each_median = ", ".join(f"{n} {m:.3g}" for n, m in zip(labels, middle, strict=True))
    return f"Medians: {each_median}."


def _per_area(plot: PlotData) -> list[str]:
    name, areas = "inter_spawn_per_area", plot.reference.place.spawn_areas
    curves = plot.curves(name, samples=areas)
    gaps = _gaps(plot)
    found = []
    for k in _busiest(gaps):
        x, y = plot.areas.spawn.mean[k]
        where = f"({x:.1f}, {y:.1f})".replace("-", "−")
        found.append(
            _figure(
                partial(
                    panels.survival,
                    plot=plot,
                    curves=curves,
                    unit=plot.scene.grid_s,
                    what="gap (s)",
                    area=k,
                ),
                caption=f"<b>Area {k}</b> around {where} m, {gaps[k]} recorded gaps",
                alt=f"Survival curves of gaps between arrivals at spawn area {k}. "
                f"{medians(plot, curves, plot.scene.grid_s, k)}",
                width=3.0,
                height=2.2,
            )
        )
    return found


def _gaps(plot: PlotData) -> list[int]:
    """Recorded gaps of each spawn area."""
    each = plot.reference.statistics["inter_spawn_per_area"].values()
    return [int(counts.sum()) for counts in each]


def _busiest(gaps: Sequence[int]) -> list[int]:
    """The areas worth a picture, at least one."""
    order = np.argsort(gaps, kind="stable")[::-1].tolist()
    return [k for k in order[:_MOST_AREAS] if gaps[k] >= _LEAST_GAPS] or order[:1]


def _which_areas(plot: PlotData) -> str:
    gaps = _gaps(plot)
    shown = _busiest(gaps)
    left_out = len(gaps) - len(shown)
    others = (
        f" {left_out} with {sum(gaps) - sum(gaps[k] for k in shown)} recorded gaps together "
        f"{'is' if left_out == 1 else 'are'} not drawn."
        if left_out
        else ""
    )
    return f'<p class="note">Busiest area first.{others}</p>'


def _map_height(plot: PlotData, extra: float = 0.5) -> float:
    b = plot.scene.bounds
    return (_WIDTH - 0.6) * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + extra


def _flows(plot: PlotData) -> list[str]:
    found = []
    goals = plot.reference.place.goal_areas
    labels = ["recorded", *(group.label for group in plot.groups)]
    for label, share in zip(labels, plot.cells("origin_destination"), strict=True):
        k, g = divmod(int(np.argmax(share)), goals)
        found.append(
            _figure(
                partial(panels.flows, plot=plot, share=share),
                caption=f"<b>{escape(label)}</b>",
                alt=f"Map of the ways that people walk, {label}. Most, {100 * share.max():.0f} %, "
                f"from spawn area {k} to goal area {g}.",
                height=_map_height(plot),
            )
        )
    return found


def _occupancy(plot: PlotData) -> list[str]:
    shares = plot.cells("occupancy")
    # A cell where people pile up must not darken all others.
    top = 100 * float(np.percentile(shares[0][shares[0] > 0], 99.5)) if shares[0].any() else 1.0
    labels = ["recorded", *(group.label for group in plot.groups)]
    found = []
    for label, share in zip(labels, shares, strict=True):
        differs = 50 * float(np.abs(share - shares[0]).sum())
        found.append(
            _figure(
                partial(_occupied, plot=plot, share=share, top=top),
                caption=f"<b>{escape(label)}</b>",
                alt=f"Map of where people spend their time, {label}."
                + (f" It differs from the recording in {differs:.0f} % of the time."
                   if label != "recorded" else ""),
                height=_map_height(plot, 1.05),
            )
        )  # fmt: skip
    return found


def _occupied(axis: "Axes", plot: PlotData, share: np.ndarray, top: float) -> None:
    image = panels.occupancy(axis, plot, share, top)
    bar = axis.figure.colorbar(image, ax=axis, location="bottom", aspect=40, extend="max", pad=0.02)
    bar.set_label("% of people’s time per m²")


def _paths(plot: PlotData) -> list[str]:
    found = []
    for group in plot.groups:
        count = min(len(group.crowds[0]), panels.MOST_PATHS)
        found.append(
            _figure(
                partial(panels.paths, plot=plot, crowd=group.crowds[0]),
                caption=f"<b>{escape(group.label)}</b>, the first {count} people",
                alt=f"Paths of {count} people in one rollout of {group.label}, drawn over walls, "
                "spawn areas and goal areas.",
                height=_map_height(plot),
                kind="small png",
            )
        )
    return found
