"""Streams to the viewer, and its layout: a view per side, and below them plots and a log."""

from collections.abc import Mapping

import rerun as rr
import rerun.blueprint as rrb

from crowdbench.scene import Scene
from crowdbench.viewer import access
from crowdbench.viewer.place import WORLD, extent_m

_BACKGROUND = (18, 18, 18)
_MARGIN = 0.03
_SPEED = 2.0  # seconds of the crowd in a second of playing


def new_stream(scene: Scene, title: str) -> rr.RecordingStream:
    """A stream for one recording in the viewer; the viewer keeps a layout per scene."""
    stream = rr.RecordingStream(f"crowdbench {scene.id}")
    stream.send_recording_name(title)
    return stream


def open_stream(scene: Scene, title: str, first_look: rrb.Blueprint) -> rr.RecordingStream:
    """A stream to the viewer that is open, or to a new window.

    Raises:
        SettingError: as `check_screen`, or the window did not open.
    """
    access.check_screen()
    stream = new_stream(scene, title)
    stream.spawn(port=access.PORT, connect=False)
    if not access.listens():
        raise access.no_screen("a window that did not open")
    address = f"rerun+http://127.0.0.1:{access.PORT}/proxy"
    stream.connect_grpc(address, default_blueprint=first_look)
    return stream


def layout(
    scene: Scene, sides: Mapping[str, str], *, live: bool, most: Mapping[str, float]
) -> rrb.Blueprint:
    """The default layout.

    Args:
        scene: the scene.
        sides: titles of the views, by the name of the side.
        live: whether data arrive while they are shown, and the viewer follows them; otherwise it
            plays from the start.
        most: maxima of the plots `agents` and `spawns`, for their axes; unknown ones are left out.
    """

    def plot(origin: str, title: str) -> rrb.TimeSeriesView:
        axis = rrb.ScalarAxis(range=(0.0, 1.5 * most[origin])) if origin in most else None
        # Without a range, the axis shows all of the time line that is chosen: `time` or `frame`.
        legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
        return rrb.TimeSeriesView(origin=origin, name=title, plot_legend=legend, axis_y=axis)

    log = rrb.TextLogView(
        origin="outcomes",
        name="outcomes",
        # The text contains the time; the time column would be too narrow to read.
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
            play_state="following" if live else "playing",
            playback_speed=_SPEED,
        ),
        auto_layout=False,
        auto_views=False,
    )


def _place(scene: Scene, side: str, title: str) -> rrb.Spatial2DView:
    b = scene.bounds
    margin = _MARGIN * extent_m(scene)
    # In the coordinates of the view, above the flip in `place`, y points downwards.
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
