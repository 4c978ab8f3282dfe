"""How HTML and Markdown pages write numbers, names and protocols; environments of templates."""

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.scene import Scene
from crowdbench.scoring.score import Score

NOTHING = "–"
PROTOCOLS = {
    "full": "models are fitted to the whole recording and compared with the whole recording. "
    "This measures how well they fit, not how well they predict.",
    "heldout": "the recording’s time blocks are divided into three interleaved folds. Models are "
    "fitted to two folds and compared with the third, for each of the three; means are shown.",
}

STEERED = (
    "A crowd under a scenario (model+file) is meant to differ from the recording: its distances "
    "measure by how much, and it is not ranked."
)


def plainly(value: float) -> str:
    """A number with two decimals and a true minus sign; 0.00 instead of −0.00."""
    return f"{value if abs(value) >= 0.005 else 0.0:.2f}".replace("-", "−")


def with_interval(score: Score) -> str:
    """A score with its 95 % interval, for example `0.63 [0.51, 0.74]`."""
    low, high = map(plainly, score.interval)
    return f"{plainly(score.value)} [{low}, {high}]"


def number(score: Score | None) -> str:
    """A score without its interval, or `–` if there is none."""
    return NOTHING if score is None else plainly(score.value)


def interval(score: Score | None) -> str:
    """A score with its interval, or `–` if there is none."""
    return NOTHING if score is None else with_interval(score)


def speed(value: float | None) -> str:
    """A speed in m/s with two decimals, or `–` if it is unknown."""
    return NOTHING if value is None else f"{value:.2f}"


def share(value: float | None) -> str:
    """A share in percent with one decimal, or `–` if it is unknown."""
    return NOTHING if value is None else f"{100 * value:.1f} %"


def digits(value: float) -> str:
    """A number with three significant digits; from 100 on, rounded to an integer."""
    if 0 < abs(value) < 0.001:
        return "<\u202f0.001"
    return (f"{value:#.3g}" if abs(value) < 99.95 else f"{value:,.0f}").replace("-", "−")


def named(scene: Scene) -> str:
    """The scene as a shown command names it: its id, or `path/to/…` for a user's own scene."""
    return scene.id if scene.asked == scene.id else f"path/to/{scene.folder.name}"


def to_import(scene: Scene) -> str:
    """The command that imports a scene's recording, in backticks."""
    name = scene.recording.name
    return f"`crowdbench data {'fetch' if name in SOURCES else 'import'} {name}`"


def environment(folder: Path, *, html: bool = True) -> Environment:
    """An environment for the templates in a folder; a value that a template lacks is an error.

    With `html`, values are escaped unless they are `markupsafe.Markup`. Lines that contain only
    block tags leave no trace in the page.
    """
    return Environment(
        loader=FileSystemLoader(folder, encoding="utf-8"),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
