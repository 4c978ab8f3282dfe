"""A minute of each entry's crowd, which its page shows.

    python -m studies clips ID

simulates an entry once on each of its scenes, with models that are scored on a part of the
recording that they have not seen. Recorded arrivals cannot be published, so on track walk people of
`cox-plans` enter. Models that repeat the recording and random walkers have no clips, and neither
have trajectories that crowdbench did not simulate.
"""

import zlib
from pathlib import Path

import msgspec

from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.leaderboard.submission.submission import Submission, read_submission
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.report.html.player import Clip, busiest, check_clip, clip_of
from crowdbench.run.jobs import Pair
from crowdbench.run.resolved import Resolved
from crowdbench.run.rollout import rollout, seed_of
from crowdbench.scene import load_scene

FILE = "clips/{}.json.gz"
"""The clips of an entry, in the folder of the leaderboard."""
HORIZON_S = 1200.0
"""Length of the rollouts whose busiest minute is shown, seconds."""
ARRIVALS = "cox-plans"
"""The spawn model of the clips on track walk."""
UNSHOWN = ("replay", "block-replay", "recorded-paths", "random")
"""Models whose clips would show the recording, and random walkers, whose clips would be large."""


class Clips(msgspec.Struct, frozen=True):
    """The clips of an entry."""

    scenes: dict[str, Clip] = {}
    """By scene; none of the models in `UNSHOWN`."""


def write_clips(entry_id: str, root: Path) -> Path:
    """Simulate the clips of an entry of the leaderboard `root`, and write and return their file.

    Raises:
        SubmissionError: its submission is invalid.
        OutputError: the file cannot be written.
    """
    submission = read_submission(root / "submissions" / entry_id)
    pairs = {scene: pair_of(submission, scene) for scene in submission.declared.scenes}
    clips = {scene: _clip(submission, scene, pair) for scene, pair in pairs.items() if pair}
    path = root / FILE.format(entry_id)
    write_json(path, Clips(clips), compact=True)
    return path


def read_clips(entry: Entry, root: Path) -> Clips:
    """Read the clips of an entry; there are none if it has no file, or a flag for copying.

    Raises:
        WeightsError: the file is broken.
    """
    path = root / FILE.format(entry.id)
    if not path.is_file() or any(flag.what.startswith("copied") for flag in entry.flags):
        return Clips()
    hint = f"Run `python -m studies clips {entry.id}`."
    clips = read_struct(path, Clips, WeightsError, hint)
    for scene, clip in clips.scenes.items():
        try:
            check_clip(clip)
        except (ValueError, zlib.error) as error:
            got = f"{scene}: {error}"
            raise WeightsError(path, got=got, expected="clips", hint=hint) from error
    return clips


def pair_of(submission: Submission, scene: str) -> Pair | None:
    """Spawn model and policy of the clip of a submission on a scene; None if it has no clip."""
    on_walk = submission.declared.track == "walk"
    spawn = ARRIVALS if on_walk else submission.spawn_of(scene)
    pair = spawn, submission.policy_of(scene)
    return None if set(pair) & set(UNSHOWN) or submission.layout.crowds else pair


def split_of(submission: Submission) -> str:
    """The part of the recording that the models of a submission's clips were fitted to."""
    return SPLITS[0] if submission.protocol == "full" else SPLITS[1]


def _clip(submission: Submission, name: str, pair: Pair) -> Clip:
    crowd = _crowd(submission, name, *pair)
    start = None
    if submission.declared.track == "walk":  # all policies in the same minute, with the same people
        start = busiest(_crowd(submission, name, pair[0], "straight"))
    return clip_of(crowd, load_scene(name), start)


def _crowd(submission: Submission, name: str, spawn: str, policy: str) -> Trajectories:
    scene, split = load_scene(name), split_of(submission)
    models = Resolved.of(scene, spawn, policy)
    return rollout(
        scene,
        models.spawn.model(split),
        models.policy.policy(split),
        seed=seed_of(split, 0),
        horizon_s=min(HORIZON_S, scene.horizon_s),
    )
