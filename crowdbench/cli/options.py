"""Parameters that several commands have, with their help texts."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Parameter

SceneName: TypeAlias = Annotated[
    str, Parameter(help="id of a scene (see `crowdbench scene list`), or its folder")
]
Workers: TypeAlias = Annotated[
    int | None, Parameter(help="worker processes (default: one per core)")
]
# The runner of commands opens it; their functions need not read it.
EngineName: TypeAlias = Annotated[
    str,
    Parameter(help="where they run: local, ray, or the address ray://HOST:PORT of a Ray cluster"),
]
Json: TypeAlias = Annotated[
    str | None,
    Parameter(
        allow_leading_hyphen=True,
        help="file to which the scores are also written as JSON; with -, nothing but JSON is "
        "printed",
    ),
]
Gaps = Literal["interpolate", "split"]
Written: TypeAlias = Literal["csv", "trajnet", "jupedsim"]


@Parameter(name="*")
@dataclass(frozen=True)
class OwnFile:
    """How a recording of the user's own is read."""

    layout: Annotated[str | None, Parameter("--format")] = None
    """format of the recording. obsmat: format of ETH and UCY; gc, forum: formats of Grand Central
    and the Forum; csv: a table with person_id, frame or time_s, x, y; trajnet: TrajNet++;
    frame-ped-xy: text of TrajNet and Social GAN; jupedsim: text or SQLite of JuPedSim and PedPy;
    sumo: SUMO's FCD; vsp: UCY's splines; sdd: Stanford Drone Dataset; with PedPy: vadere, hdf5,
    viswalk, pathfinder, crowdit; or a format of an installed package"""
    dt_s: float | None = None
    """time between two rows of a person in seconds, if the file does not state it"""
    gaps: Gaps | None = None
    """repair missing rows of a person: interpolate linearly, or split the person into two; both
    also interpolate rows that lie between frames (default: reject such files)"""
    offset_s: float | None = None
    """time_s of the first frame of a table, in seconds (default: 0)"""
    scale: float | None = None
    """metres per unit of the positions in the file, such as 0.01 for centimetres"""
    homography: Path | None = None
    """text file with the 3 × 3 matrix that maps the positions in the file to metres"""
    resample: float | None = None
    """interpolate rows at any times to frames of so many seconds"""

    def given(self) -> list[str]:
        """The options that were given."""
        named = {"--format" if k == "layout" else f"--{k}": v for k, v in asdict(self).items()}
        return [name.replace("_", "-") for name, value in named.items() if value is not None]
