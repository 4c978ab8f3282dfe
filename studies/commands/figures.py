"""`python -m studies figures`: draw the figures of scenes and write their data."""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.cli.options import EngineName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.run.processes import LOCAL


def figures(
    scenes: list[str],
    /,
    *,
    figure: Sequence[str] = ("policies", "flows", "situations", "sheet"),
    spawn: str = "cox-plans",
    policy: str | None = None,
    seeds: int = 5,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    out: Path = Path("docs/figures"),
) -> None:
    """Draw figures of trajectories and arrivals, with their data (minutes).

    Args:
        scenes: ids of scenes, or their folders
        figure: policies (simulated next to recorded paths), flows (density and mean paths per
            spawn area), situations (recorded windows and the most similar simulated ones), sheet
            (curves of all scenes in one figure)
        spawn: spawn model, shown with poisson-gmm
        policy: policy that moves the people (default: anticipate if it ships with the scene, else
            social-force)
        seeds: rollouts of each spawn model
        out: output folder
    """
    from studies.figures import write_figures

    with progress_bar("rollouts") as progress:
        made = write_figures(
            scenes,
            figures=figure,
            spawn=spawn,
            policy=policy,
            out=out,
            seeds=seeds,
            workers=workers,
            progress=progress,
        )
    for path in made:
        print(f"written to {path} and {path.with_suffix('.json').name}")
