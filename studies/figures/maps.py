"""Maps of a scene side by side on the same scale."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from crowdbench.report.plots.canvas import picture
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Map = tuple[str, Callable[["Axes"], None]]
"""A title, and a function that draws the scene and its content onto axes."""

_TITLE_IN = 0.2
_GAP_IN = 0.2
_LEGEND_IN = 0.18
_MARGIN_IN = 0.4


def maps(
    scene: Scene,
    shown: Sequence[Map],
    *,
    width: float,
    columns: int,
    handles: Sequence[Any] = (),
    legend_columns: int = 2,
) -> bytes:
    """Bytes of a small png with maps of the scene, each `width` inches wide.

    The legend of `handles` is below the maps, because areas may lie in any corner of a map.
    """
    b = scene.bounds
    columns = min(columns, len(shown))
    rows = -(-len(shown) // columns)
    lines = 1 + max(title.count("\n") for title, _ in shown)
    explained = -(-len(handles) // legend_columns)
    height = width * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)

    def draw(axes: "list[Axes]") -> None:
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
        for k, (axis, (title, draw_map)) in enumerate(zip(axes, shown, strict=False)):
            draw_map(axis)
            axis.set_title(title, fontsize=9)
            axis.set_ylabel("y (m)" if k % columns == 0 else "")
            below = k + columns < len(shown)
            axis.set_xlabel("" if below else "x (m)")
            axis.tick_params(labelbottom=not below)  # also above unused axes
        if handles:
            axes[0].figure.legend(
                handles=list(handles), loc="outside lower center", ncols=legend_columns
            )

    return picture(
        draw,
        width=width * columns + 0.6,
        height=(height + _TITLE_IN * lines + _GAP_IN) * rows + _MARGIN_IN + _LEGEND_IN * explained,
        rows=rows,
        columns=columns,
        kind="small png",
    )
