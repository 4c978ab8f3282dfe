"""`python -m studies walks`: write the page that compares how policies walk."""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.cli.options import EngineName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.run.processes import LOCAL


def walks(
    scenes: list[str],
    /,
    *,
    policy: Sequence[str] = (),
    out: Path = Path("docs"),
    workers: Workers = None,
    engine: EngineName = LOCAL,
    seeds: int | None = None,
) -> None:
    """Write the page that compares how policies walk, with pictures (minutes).

    Args:
        scenes: ids of scenes, or their folders
        policy: policies in addition to random, straight, social-force and those of each scene
        out: output folder of walks.md and its pictures
        seeds: rollouts of each policy (in each fold). Scores of stochastic policies need at least
            two rollouts (default: 2)
    """
    from studies.walks import write_walks

    with progress_bar("rollouts") as progress:
        page = write_walks(
            scenes, more=policy, out=out, seeds=seeds, workers=workers, progress=progress
        )
    print(f"written to {page} and {page.with_suffix('')}/")
