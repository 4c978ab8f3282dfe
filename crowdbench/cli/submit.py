"""`crowdbench submit`: create and check a submission to the leaderboard."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from crowdbench.cli.running import new_app
from crowdbench.report.text.terminal import print_facts

app = new_app("submit", "Create and check a submission to the leaderboard.")


@app.command
def init(
    folder: Path,
    /,
    *,
    track: Literal["walk", "spawn", "crowd"],
    name: str = "",
    policy: Sequence[Path] = (),
    scene: Sequence[str] = (),
) -> None:
    """Create the folder of a new submission to fill in.

    Args:
        folder: folder to create
        track: walk: a policy with the recorded arrivals; spawn: a spawn model with straight
            walkers; crowd: a spawn model and a policy
        name: name on the leaderboard (default: the name of the folder)
        policy: networks to copy: for each scene a folder with fold0.onnx, fold1.onnx and
            fold2.onnx, or one FILE.onnx that was trained on none of the scenes
        scene: scenes of the submission (default: those of the policies, else eth-v0 gc-v0 forum-v0)
    """
    from crowdbench.leaderboard.submission.template import start_submission

    scenes = start_submission(folder, track, name=name, scenes=scene, policies=policy)
    print(f"{folder}: track {track} on {', '.join(scenes)}")
    print(
        f"Fill in {folder / 'submission.toml'} as described in {folder / 'README.md'}. "
        f"Next: crowdbench submit check {folder}"
    )


@app.command
def check(submission: Path, /) -> None:
    """Check a submission and list all its problems.

    Args:
        submission: folder of a submission
    """
    from crowdbench.leaderboard.submission import submission as submissions

    checked = submissions.check(submission)
    declared, layout, (status, why) = checked.declared, checked.layout, checked.judged
    counts = {
        "networks": len(layout.networks),
        "files of fits": len(layout.weights),
        "rollouts": sum(map(len, layout.crowds.values())),
    }
    models = [name for name in (declared.shipped_spawn, declared.shipped_policy) if name]
    models += [f"{what}: {count}" for what, count in counts.items() if count]
    print_facts(
        declared.name,
        {
            "id": checked.id,
            "track": f"{declared.track}, {declared.kind}, trained: {declared.training.protocol}",
            "scenes": ", ".join(declared.scenes),
            "models": ", ".join(models),
            "status": f"{status}: {why}",
        },
    )
