"""Checks of this machine: `busy-steps` and `ray-cluster`."""

from typing import Annotated

from cyclopts import Parameter


def busy_steps() -> None:
    """Measure steps while four other processes are busy (minutes)."""
    from studies.busy_steps import times

    for line in times():
        print(line, flush=True)


def ray_cluster(*arguments: Annotated[str, Parameter(allow_leading_hyphen=True)]) -> None:
    """Evaluate on a Ray cluster of this machine that loses a node.

    Args:
        arguments: scene and options, as of `crowdbench evaluate`
    """
    from studies.ray_cluster import compare

    if not compare(list(arguments)):
        raise SystemExit(1)
