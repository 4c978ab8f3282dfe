"""`python -m studies growth`: measure how cost grows with people, worlds and threads."""

from pathlib import Path


def growth(*, out: Path | None = None) -> None:
    """Measure how the cost of a simulation grows with its size (minutes).

    Args:
        out: also write the page to this file (docs/growth.md)
    """
    from contextlib import nullcontext

    from crowdbench.files import replacing
    from studies.growth_page import page

    # Opened first: a file that cannot be written raises an error before minutes of measuring.
    with replacing(out) if out else nullcontext() as temporary:
        parts = []
        for part in page():
            print(part, flush=True)
            parts.append(part)
        if temporary is not None:
            temporary.write_text("\n".join(parts))
