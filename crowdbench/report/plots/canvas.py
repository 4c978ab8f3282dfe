"""Pictures as bytes; the same drawing gives the same bytes.

The user's matplotlibrc, the time and random ids would otherwise change the bytes.
"""

from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Draw = Callable[["list[Axes]"], object]

_DPI = 150
_PALETTE = 64
_STYLE: dict[str, Any] = {
    "svg.hashsalt": "crowdbench",
    "font.size": 9.0,
    "axes.titlesize": 11.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
}


def picture(
    draw: Draw,
    *,
    width: float,
    height: float,
    rows: int = 1,
    columns: int = 1,
    kind: Literal["png", "small png", "svg"] = "svg",
    shared: bool = True,
) -> bytes:
    """Bytes of a picture whose axes (rows × columns) are filled by `draw`; sizes are in inches.

    With `shared`, all axes have the same scales. A `small png` has 64 colours, which makes pictures
    with many overlapping lines much smaller.
    """
    # The figure has its own canvas, so that no window system and no state of pyplot is used.
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    buffer = BytesIO()
    with matplotlib.style.context(["default", _STYLE]):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(
            rows, columns, sharex=shared, sharey=shared and columns > 1, squeeze=False
        )
        draw(list(axes.ravel()))
        if kind == "svg":
            nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
            figure.savefig(buffer, format="svg", metadata=nothing)
        else:
            figure.savefig(buffer, dpi=_DPI, format="png", metadata={"Software": None})
    if kind != "small png":
        return buffer.getvalue()
    from PIL import Image

    small = BytesIO()
    with Image.open(buffer) as image:
        # Median cut would drop the colours of small objects.
        few = image.convert("RGB").quantize(_PALETTE, method=Image.Quantize.FASTOCTREE)
        few.save(small, format="png", optimize=True)
    return small.getvalue()
