"""From a drawing function to the bytes of a picture, the same bytes for the same drawing.

What a user's own matplotlibrc says, the time and random ids would all show in the bytes.
"""

from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Draw = Callable[["list[Axes]"], None]

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
    """Let `draw` fill rows × columns axes of a figure (inches), which share their scales or not.

    A `small png` keeps 64 colours: a fraction of the size where lines lie thick over each other.
    """
    # A figure of its own canvas: no window system and no global state of pyplot's is touched.
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
    return _with_few_colours(buffer) if kind == "small png" else buffer.getvalue()


def _with_few_colours(png: BytesIO) -> bytes:
    from PIL import Image

    small = BytesIO()
    with Image.open(png) as image:
        # The median cut would give the colours of small things to large ones.
        few = image.convert("RGB").quantize(_PALETTE, method=Image.Quantize.FASTOCTREE)
        few.save(small, format="png", optimize=True)
    return small.getvalue()
