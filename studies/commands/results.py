"""`python -m studies results`: write a scene's results page."""

from pathlib import Path

from crowdbench.cli.options import EngineName, SceneName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.run.processes import LOCAL


def results(
    scene: SceneName,
    /,
    *,
    out: Path = Path("docs/results"),
    workers: Workers = None,
    engine: EngineName = LOCAL,
    seeds: int | None = None,
) -> None:
    """Write a scene's results page, with pictures (minutes).

    Args:
        out: output folder of the page and its pictures
        seeds: rollouts of each crowd (in each fold). Scores need at least two rollouts per fit,
            usually 10 (default: as in the scene's protocol)
    """
    from studies.results import write_results

    with progress_bar("rollouts") as progress:
        page = write_results(scene, out=out, seeds=seeds, workers=workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")
