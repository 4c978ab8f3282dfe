"""`python -m examples.peers`: calibrate the models of other simulators, and score them."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from crowdbench.cli.running import new_app, run
from crowdbench.errors import SettingError, did_you_mean
from crowdbench.registry import recording_of
from crowdbench.run.executor import checked_workers
from crowdbench.scene import load_scene

app = new_app(
    "python -m examples.peers", "Models of other simulators, on the scenes of crowdbench."
)
SCENES = ("eth-v0", "hotel-v0", "zara1-v0", "forum-v0", "gc-v0")


@app.command
def calibrate(
    scenes: Sequence[str] = SCENES, /, *, model: Sequence[str] = (), workers: int = 1
) -> None:
    """Choose parameters on the training blocks of each fold (hours).

    Args:
        scenes: ids of scenes
        model: names of models, by default all
        workers: number of processes
    """
    from examples.peers.calibrate import calibrate

    calibrate(scenes, _known(model, scenes), workers=checked_workers(workers))


@app.command
def entries(
    scenes: Sequence[str] = SCENES,
    /,
    *,
    model: Sequence[str] = (),
    column: Sequence[Literal["published", "calibrated"]] = ("published", "calibrated"),
    workers: int = 1,
) -> None:
    """Walk the people of the recordings, and write the entries of the leaderboard (an hour).

    Args:
        scenes: ids of scenes
        model: names of models, by default all
        column: with published or calibrated parameters
        workers: number of processes
    """
    from examples.peers.entries import write_entries

    write_entries(scenes, _known(model, scenes), column, workers=checked_workers(workers))


@app.command
def exam(
    *,
    model: Sequence[str] = (),
    column: Sequence[Literal["published", "calibrated"]] = ("published", "calibrated"),
    workers: int = 1,
) -> None:
    """Put the models through the exam; their entries have its verdicts (half an hour for each).

    Args:
        model: names of models, by default all
        column: with published or calibrated parameters
        workers: number of processes
    """
    from examples.peers.entries import examine

    examine(_known(model), column, checked_workers(workers))


@app.command
def check(scenes: Sequence[str] = ("eth-v0", "hotel-v0"), /, *, rollouts: int = 5) -> None:
    """Compare ORCA through the adapter with the policy of crowdbench.

    Args:
        scenes: ids of scenes
        rollouts: number of rollouts of each
    """
    from examples.peers.check import compare

    print("held-out score: mean ± standard deviation over rollouts with other nudges")
    for scene in scenes:
        for of in compare(scene, rollouts):
            direct, adapted = (f"{mean:.2f} ± {sd:.2f}" for mean, sd in (of.direct, of.adapted))
            print(
                f"{of.scene} {of.family}: crowdbench {direct}, through the adapter {adapted} "
                f"({of.apart:.1f} standard errors apart)",
                flush=True,
            )


@app.command
def crossing(scene: str = "gc-v0", /, *, out: Path = Path("docs/peers/crossing.png")) -> None:
    """Draw a typical crossing as recorded, and as four models walk it.

    Args:
        scene: id of a scene
        out: PNG file to write
    """
    from examples.peers.models import (
        AnticipationVelocity,
        CollisionFreeSpeedV2,
        SocialForceJuPedSim,
        WarpDriver,
    )
    from studies.crossing import write_crossing

    kinds = (CollisionFreeSpeedV2, AnticipationVelocity, SocialForceJuPedSim, WarpDriver)
    walkers = {kind.name: lambda split, kind=kind: kind() for kind in kinds}
    for name, gap in write_crossing(scene, walkers, out).items():
        print(f"{name}: {'–' if gap is None else f'{gap:.2f} m'}")
    print(f"written to {out}")


def _known(models: Sequence[str], scenes: Sequence[str] = ()) -> Sequence[str]:
    """The models, by default all; a wrong name is answered before hours of work."""
    from examples.peers.models import MODELS

    for scene in scenes:
        recording_of(load_scene(scene))
    for name in models:
        if name not in MODELS:
            expected, hint = f"one of {', '.join(MODELS)}", did_you_mean(name, MODELS)
            raise SettingError("--model", got=repr(name), expected=expected, hint=hint)
    return models or tuple(MODELS)


if __name__ == "__main__":
    sys.exit(run(app))
