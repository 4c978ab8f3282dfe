"""`python -m studies speed`: measure the speed of crowdbench on this machine."""

from contextlib import nullcontext
from pathlib import Path


def speed(*, judging: str | None = None, json: Path | None = None) -> None:
    """Measure the speed of crowdbench on this machine.

    Args:
        judging: instead measure where the CPU time of scoring rollouts of this scene goes
        json: also write the results to this file
    """
    from crowdbench.files import replacing, write_json
    from crowdbench.scene import load_scene
    from studies.judging import measure_judging
    from studies.speed import measure

    measured = measure() if judging is None else measure_judging(load_scene(judging))

    # Opened first: a file that cannot be written raises an error before a minute of measuring.
    with replacing(json) if json else nullcontext() as temporary:
        figures = []
        for figure in measured:
            print(f"{figure.name:<48} {figure.text()}", flush=True)
            figures.append(figure)
        if temporary is not None:
            write_json(temporary, {f.name: {"value": f.value, "unit": f.unit} for f in figures})
