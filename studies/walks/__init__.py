"""The page on policies: scores and distances under recorded arrivals, by scene.

`write_walks` evaluates the simple policies, the policies that a scene ships and any others, and
writes a Markdown page with pictures, meant to be kept under version control. All numbers come from
rollouts: the same rollouts give the same bytes.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from crowdbench.data.storage import read_own
from crowdbench.errors import RecordingError, SettingError
from crowdbench.files import replacing, write_text
from crowdbench.policies import RecordedPaths
from crowdbench.registry import has_recording, recording_of, trained_policies
from crowdbench.registry import policy as find_policy
from crowdbench.report.plots.plot_data import Crowds
from crowdbench.run.jobs import plan
from crowdbench.run.judge import judge
from crowdbench.run.references import classifier_test_of, reference_of
from crowdbench.run.rollout import rollout
from crowdbench.run.rollout_jobs import Progress, roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.scorecard import Protocol, Scorecard, read_anchors
from crowdbench.spawn import Replay
from studies.walks.page import Walked, page
from studies.walks.pictures import draw_dwell

PLAIN = ("random", "straight", "social-force")
ARRIVALS = "ntpp-gmm"
"""The spawn model for the table of arrivals at the goal, in addition to recorded arrivals."""
FEW = 2
"""Number of rollouts: enough for scores under the recorded arrivals, and for distances."""


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

    Returns the path of the page. The policies are `random`, `straight`, `social-force`, `more`, and
    those that each scene ships. Rollouts are kept in `walks-<scene>-…` of `work`, where a later
    call reuses them. `seeds` is the number of rollouts per policy (and fold), by default the
    smallest number that gives scores, which entries of the leaderboard have, too; `workers` and
    `progress` are those of `evaluate`. Pictures show one rollout of each policy that is trained on
    the whole recording.

    Raises:
        RecordingError: a recording has not been imported.
        SceneError, WeightsError, SettingError: as `evaluate`.
        OutputError: `out` or `work` cannot be written.
    """
    places = [load_scene(scene) for scene in dict.fromkeys(scenes)]
    if not places:
        raise SettingError("walks", got="no scene", expected="one or more scenes")
    for place in places:
        if not has_recording(place):
            raise RecordingError(
                place.id,
                got="no recording",
                expected="the recording, because policies are run under the recorded arrivals",
                hint=f"Run `crowdbench data fetch {place.recording.name}`.",
            )
    path = out / "walks.md"
    with replacing(path) as temporary:  # fails early if the page cannot be written
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
    seeds = FEW if seeds is None else seeds
    reference, folder = reference_of(place), work / f"walks-{place.id}"

    def evaluated(spawn: str, protocol: Protocol, seeds: int) -> Scorecard:
        pairs = [(spawn, p) for p in policies]
        jobs = plan(place.asked, place, pairs, protocol, seeds, folder / "rollouts")
        without = [replace(job, shown=False) for job in jobs]
        rolled = roll_out(without, reference, workers, progress)
        scale = read_anchors(place).protocols[protocol]
        return judge(place, reference, rolled, protocol, seeds, scale)

    card = evaluated("replay", "heldout", seeds)
    sampled = evaluated(ARRIVALS, "full", FEW)
    pairs = [("replay", p) for p in policies]
    jobs = plan(place.asked, place, pairs, "full", 1, folder / "rollouts")
    roll_out(jobs, None, workers, progress)
    crowds: Crowds = {(j.spawn, j.policy, j.seed): read_own(j.path) for j in jobs}
    recording = recording_of(place)
    draw_dwell(place, reference, crowds, names, out / "walks")
    walked = rollout(place, Replay(recording), RecordedPaths(recording), seed=0)
    test = classifier_test_of(place)
    told = {policy: test.auc(crowd) for (_, policy, _), crowd in crowds.items()}
    return Walked(place, names, sees, card, sampled, reference.score(walked), told)


__all__ = ["write_walks"]
