"""How policies walk, on one page: scores and distances under recorded arrivals, scene by scene.

`write_walks` evaluates the plain walkers, the policies that a scene ships and any others, and
writes a page in Markdown with pictures, meant to be kept under version control. All of it comes
from rollouts: the same ones give the same bytes.
"""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.errors import RecordingError, SettingError
from crowdbench.evaluation.evaluate import evaluate
from crowdbench.evaluation.rollout_jobs import Progress, plan
from crowdbench.files import replacing, write_text
from crowdbench.policies import ReplayPolicy
from crowdbench.registry import has_recording, recording_of, trained_policies
from crowdbench.registry import policy as find_policy
from crowdbench.report.plots.plot_data import Crowds
from crowdbench.rollouts.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import Protocol, Scorecard
from crowdbench.spawn import Replay
from crowdbench.studies.walks.page import Walked, page
from crowdbench.studies.walks.pictures import draw_dwell
from crowdbench.trajectories.storage import read_own

PLAIN = ("random", "straight", "social-force")
ARRIVALS = "ntpp-gmm"
"""Under these too, beside the recorded ones, it is looked whether people get to their goals."""
FEW = 2
"""Rollouts there, which distances are made of and no scores."""


class RecordedPaths(ReplayPolicy):
    """Walks people along their recorded paths until they come to their goals, as all policies do.

    `replay` lets them go on to the end of their record.
    """

    name = "recorded paths"


def write_walks(
    scenes: Sequence[str],
    *,
    more: Sequence[str] = (),
    out: Path = Path("docs"),
    work: Path = Path("results"),
    seeds: int | None = None,
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Evaluate policies on scenes and write `walks.md` and `walks/<scene>-dwell.png` into `out`.

    These are `random`, `straight`, `social-force`, `more`, and those that each scene ships. The
    rollouts are left in `walks-<scene>-…` of `work`, where another call takes up what is there.
    `seeds` rollouts of a policy (in each fold), by default the fewest that make scores; `workers`
    and `progress` are those of `evaluate`.

    Raises:
        RecordingError: a recording has not been imported.
        SceneError, WeightsError, SettingError: as `evaluate`.
        OutputError: `out` or `work` cannot be written.
    """
    places = [load_scene(scene) for scene in dict.fromkeys(scenes)]
    if not places:
        raise SettingError("walks", got="no scene", expected="one or more")
    for place in places:
        if not has_recording(place):
            raise RecordingError(
                place.id,
                got="no recording",
                expected="its recording, under whose arrivals policies walk",
                hint=f"Run `crowdbench data fetch {place.recording.name}`.",
            )
    path = out / "walks.md"
    with replacing(path) as temporary:  # that it can be written is found out first
        found = [_walk(place, more, out, work, seeds, workers, progress) for place in places]
        write_text(temporary, page(found, more, seeds))
    return path


def _walk(
    place: Scene,
    more: Sequence[str],
    out: Path,
    work: Path,
    seeds: int | None,
    workers: int | None,
    progress: Progress,
) -> Walked:
    policies = list(dict.fromkeys([*PLAIN, *more, *trained_policies(place)]))
    walkers = {p: find_policy(p, place) for p in policies}
    names = {p: walker.name for p, walker in walkers.items()}
    sees = {p: str(walker.sees) for p, walker in walkers.items()}
    seeds = 2 * place.protocol.fits if seeds is None else seeds
    folder = work / f"walks-{place.id}-full"
    cards: dict[Protocol, Scorecard] = {}
    protocols: tuple[Protocol, ...] = ("full", "heldout")
    for protocol in protocols:
        cards[protocol] = evaluate(
            place.asked,
            spawn=["replay"],
            policy=policies,
            protocol=protocol,
            seeds=seeds,
            workers=workers,
            out=work / f"walks-{place.id}-{protocol}",
            progress=progress,
        )
    sampled = evaluate(
        place.asked,
        spawn=[ARRIVALS],
        policy=policies,
        seeds=FEW,
        workers=workers,
        out=work / f"walks-{place.id}-{ARRIVALS}",
        progress=progress,
    )
    pairs = [("replay", p) for p in policies]
    jobs = plan(place.asked, place, pairs, "full", seeds, folder / "rollouts")
    crowds: Crowds = {(j.spawn, j.policy, j.seed): read_own(j.path) for j in jobs}
    recording, reference = recording_of(place), read_reference(place)
    draw_dwell(place, reference, crowds, names, out / "walks")
    walked = rollout(place, Replay(recording), RecordedPaths(recording), seed=0)
    return Walked(place, names, sees, cards, sampled, reference.score(walked))


__all__ = ["write_walks"]
