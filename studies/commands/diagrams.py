"""`python -m studies diagrams` and `moving-picture`: draw pictures of the documentation."""

from pathlib import Path


def diagrams(*, out: Path = Path("docs/diagrams")) -> None:
    """Draw the diagrams of the documentation.

    Args:
        out: output folder
    """
    from studies.diagrams import write_diagrams

    print(f"written to {', '.join(str(path) for path in write_diagrams(out))}")


def moving_picture(*, out: Path = Path("docs/crowds.webp")) -> None:
    """Write the moving picture of the README.

    Args:
        out: output file
    """
    from studies.moving_picture import write_moving_picture

    print(f"written to {write_moving_picture(out)}")
