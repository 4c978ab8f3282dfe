"""`python -m studies diagrams`: draw the diagrams of the documentation."""

from pathlib import Path


def diagrams(*, out: Path = Path("docs/diagrams")) -> None:
    """Draw the diagrams of the documentation.

    Args:
        out: output folder
    """
    from studies.diagrams import write_diagrams

    print(f"written to {', '.join(str(path) for path in write_diagrams(out))}")
