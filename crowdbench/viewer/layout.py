"""Where the viewer puts what: the place once for each side, below them plots and a log."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from crowdbench.scene import Scene
from crowdbench.viewer.place import WORLD, extent_m

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint, Spatial2DView

_BACKGROUND = (18, 18, 18)
_MARGIN = 0.03
_SPEED = 2.0  # seconds of the crowd in a second of playing


def layout(
    scene: Scene, sides: Mapping[str, str], *, length_s: float | None, most: Mapping[str, float]
) -> "Blueprint":
    """The first look.

    Args:
        scene: the place.
        sides: a view for each, its title by its name.
        length_s: how much time the plots show, seconds; None for what comes in live, which the
            viewer then follows, and else it plays from the start.
        most: the greatest values of the plots `agents` and `spawns`, for room above them; those
            that are not known yet are left out.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    def plot(origin: str, title: str) -> rrb.TimeSeriesView:
        axis = rrb.ScalarAxis(range=(0.0, 1.5 * most[origin])) if origin in most else None
        whole = None
        if length_s is not None:
            end = rr.TimeRangeBoundary.absolute(seconds=length_s)
            start = rr.TimeRangeBoundary.absolute(seconds=0.0)
            whole = rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
        legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
        return rrb.TimeSeriesView(
            origin=origin, name=title, plot_legend=legend, axis_x=whole, axis_y=axis
        )

    log = rrb.TextLogView(
        origin="outcomes",
        name="outcomes",
        # The text tells the time: the column of it is too narrow to be read.
        columns=rrb.TextLogColumns(
            timeline_columns=[rrb.encodings.TimelineColumn("time", visible=False)],
            text_log_columns=["body"],
        ),
    )
    plots = [plot("agents", "agents over time"), plot("spawns", "spawns per 10 frames")]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*[_place(scene, side, title) for side, title in sides.items()]),
            rrb.Horizontal(*plots, log, column_shares=[6, 6, 5]),
            row_shares=[5, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline="time",
            play_state="following" if length_s is None else "playing",
            playback_speed=_SPEED,
        ),
        auto_layout=False,
        auto_views=False,
    )


def _place(scene: Scene, side: str, title: str) -> "Spatial2DView":
    import rerun.blueprint as rrb

    b = scene.bounds
    margin = _MARGIN * extent_m(scene)
    # In the view's own frame, which is above the flip of `place`: y downwards.
    bounds = rrb.VisualBounds2D(
        x_range=(b.x_min_m - margin, b.x_max_m + margin),
        y_range=(-b.y_max_m - margin, -b.y_min_m + margin),
    )
    return rrb.Spatial2DView(
        origin="/",
        contents=[f"/{WORLD}/place/**", f"/{WORLD}/{side}/**"],
        name=title,
        background=_BACKGROUND,
        visual_bounds=bounds,
    )
