"""How reports write numbers, names and protocols, be the page HTML or Markdown."""

from crowdbench.scene import Scene
from crowdbench.scoring.score import Score

NOTHING = "–"
PROTOCOLS = {
    "full": "models are fitted on the whole recording and compared with all of it. That "
    "describes how well they fit; it does not test them on anything new.",
    "heldout": "the recording’s time blocks are dealt into three interleaved folds. Models are "
    "fitted on two and compared with the third, three times, and what is shown is the mean.",
}

STEERED = (
    "A crowd under a scenario (model+file) is to be different from the recording: its distances "
    "say how different it is, and it has no rank."
)


def plainly(value: float) -> str:
    """Two decimals and a true minus sign; no −0.00."""
    return f"{value if abs(value) >= 0.005 else 0.0:.2f}".replace("-", "−")


def with_interval(score: Score) -> str:
    """`0.63 [0.51, 0.74]`."""
    low, high = map(plainly, score.interval)
    return f"{plainly(score.value)} [{low}, {high}]"


def number(score: Score | None) -> str:
    """A score alone, `–` where there is none."""
    return NOTHING if score is None else plainly(score.value)


def interval(score: Score | None) -> str:
    """A score with its interval, `–` where there is none."""
    return NOTHING if score is None else with_interval(score)


def digits(value: float) -> str:
    """Three significant digits, all of those before the point."""
    if 0 < abs(value) < 0.001:
        return "<\u202f0.001"
    return (f"{value:#.3g}" if abs(value) < 99.95 else f"{value:,.0f}").replace("-", "−")


def named(scene: Scene) -> str:
    """How a command names the scene, wherever a scene of the user's own may lie."""
    return scene.id if scene.asked == scene.id else f"path/to/{scene.folder.name}"
