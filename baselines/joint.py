"""Trains the networks from which `joint-gmm` is fitted: they learn when people come elsewhere.

    python -m crowdbench.baselines.joint

writes `joint-trunks.safetensors` into the folder of the scenes: for each recorded scene, networks
that have learned from the arrivals at all others, and for new places, networks that have learned
from all. So the arrivals of a scene are held out from what its network has learned elsewhere.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from crowdbench import registry
from crowdbench.errors import CrowdbenchError
from crowdbench.files import unwritable
from crowdbench.scene import load_scene, scenes_folder
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import Arrivals, arrivals_of, blocks_of
from crowdbench.spawn.joint.trunks import ANYWHERE, SEEDS, write_trunks

from .packages import needs

with needs("fit", __name__):
    from crowdbench.spawn.joint.training import DEFAULT, JointSettings, pretrained

PLACES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")


def arrivals_at(place: str) -> Arrivals:
    """All recorded arrivals of a scene."""
    scene = load_scene(place)
    crowd = registry.recording_of(scene)
    return arrivals_of(crowd, blocks_of(crowd, scene), len(read_areas(scene).spawn))


def trained(places: Sequence[str], folder: Path, settings: JointSettings = DEFAULT) -> Path:
    """Train networks on all of these places but one, and on all; returns the file.

    Raises:
        OutputError: the folder cannot be written.
        RecordingError: a recording has not been imported.
    """
    try:  # before minutes of training
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    arrivals = {place: arrivals_at(place) for place in places}
    trunks = {}
    for out in (*places, ANYWHERE):
        others = [each for place, each in arrivals.items() if place != out]
        trunks[out] = [pretrained(others, seed=k, settings=settings) for k in range(SEEDS)]
        print(f"{out}: learned from {len(others)} places", flush=True)
    return write_trunks(trunks, folder)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m crowdbench.baselines.joint",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=None, help="folder (default: of the scenes)")
    options = parser.parse_args(arguments)
    try:
        print(f"written to {trained(PLACES, options.out or scenes_folder())}")
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.joint: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
