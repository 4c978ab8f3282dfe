"""`python -m studies paper`: check the claims of the founding paper."""

from pathlib import Path

from crowdbench.cli.options import EngineName, SceneName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.run.processes import LOCAL


def paper(
    scene: SceneName,
    /,
    *,
    out: Path = Path("docs"),
    workers: Workers = None,
    engine: EngineName = LOCAL,
) -> None:
    """Check the founding paper's claims (minutes on ETH, hours on Grand Central).

    Args:
        out: output folder of the overview, paper.md, and of the pages and pictures of scenes in
            paper/
    """
    from studies.paper import write_paper

    with progress_bar("fits and samples") as progress:
        page = write_paper(scene, out=out, workers=workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")
