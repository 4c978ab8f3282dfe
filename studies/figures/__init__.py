"""Figures of scenes: pictures of the crowds of spawn models and policies.

`write_figures` draws them from rollouts, and writes the numbers behind each picture as JSON. The
numbers contain no recorded path and no recorded arrival.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from crowdbench import __version__
from crowdbench.data.storage import read_own
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError, did_you_mean
from crowdbench.files import replacing, unwritable, write_json
from crowdbench.registry import has_recording, recording_of, trained_policies
from crowdbench.registry import policy as find_policy
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.run.jobs import Job, plan
from crowdbench.run.processes import alone_in
from crowdbench.run.rollout_jobs import Progress, roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.areas import Areas, read_areas
from studies.figures.flows import draw_flows
from studies.figures.policies import draw_policies
from studies.figures.sheet import draw_sheet
from studies.figures.situations import draw_situations
from studies.figures.ways import Numbers

FIGURES = ("policies", "flows", "situations", "sheet")
"""Names of the figures; `sheet` shows all scenes, the others one scene."""
OF_RECORDING = ("policies", "situations")
"""Figures that require the recording."""
SPAWN = "cox-plans"
BASELINE = "poisson-gmm"
"""The spawn model with which `SPAWN` is compared."""
ROLLOUTS = 5
WALKERS = ("straight", "social-force")
BEST = "anticipate"
"""The policy that walks by default, where the scene ships it."""


def write_figures(
    scenes: Sequence[str | Path],
    *,
    figures: Sequence[str] = FIGURES,
    spawn: str = SPAWN,
    policy: str | None = None,
    out: Path = Path("docs/figures"),
    work: Path = Path("results"),
    seeds: int = ROLLOUTS,
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
) -> list[Path]:
    """Draw `figures` of scenes into `out` and return the paths of the pictures.

    The files are `<scene>/<figure>.png` and `.json`, and `sheet.png` and `.json` for all scenes.
    Crowds are `seeds` rollouts of `spawn`, and of poisson-gmm, with `policy`; it defaults to
    anticipate if the scene ships it, else to social-force. Rollouts are kept in
    `figures-<scene>` of `work`, where a later call reuses them; `workers` and `progress` are those
    of `evaluate`. The same rollouts give the same bytes.

    Raises:
        RecordingError: a figure needs a recording that has not been imported.
        SceneError, WeightsError, SettingError: a scene, model, policy or figure does not exist.
        OutputError: `out` or `work` cannot be written.
    """
    places = [load_scene(scene) for scene in dict.fromkeys(scenes)]
    _check(places, figures, spawn)
    shown = [_Shown.of(place, figures, spawn, policy, seeds, work) for place in places]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error
    for of_scene in shown:
        folder = work / f"figures-{of_scene.scene.id}"
        with alone_in(folder):
            roll_out(of_scene.jobs, None, workers, progress)
    made = [
        of_scene.write(figure, out / of_scene.scene.id)
        for of_scene in shown
        for figure in FIGURES[:-1]
        if figure in figures
    ]
    if "sheet" in figures:
        picture, numbers = draw_sheet([of_scene.plot for of_scene in shown])
        made.append(_write(out / "sheet.png", picture, {"figure": "sheet"} | numbers))
    return made


def _check(places: Sequence[Scene], figures: Sequence[str], spawn: str) -> None:
    """Reject figures that cannot be drawn, before any rollout is made."""
    if not places:
        raise SettingError("figures", got="no scene", expected="one or more scenes")
    if spawn == "replay":
        raise SettingError("spawn", got="replay, which repeats the recording",
                           expected="a spawn model that generates new crowds")  # fmt: skip
    for figure in figures:
        if figure not in FIGURES:
            raise SettingError(
                "figures",
                got=repr(figure),
                expected=f"one of {', '.join(FIGURES)}",
                hint=did_you_mean(figure, FIGURES),
            )
    wanted = [figure for figure in OF_RECORDING if figure in figures]
    for place in places:
        if wanted and not has_recording(place):
            others = [figure for figure in FIGURES if figure not in OF_RECORDING]
            raise RecordingError(
                place.id,
                got="no recording",
                expected=f"its recording, for {' and '.join(wanted)}",
                hint=f"Run `crowdbench data fetch {place.recording.name}`, or draw only "
                f"--figure {' '.join(others)}.",
            )


@dataclass(frozen=True, eq=False)
class _Shown:
    """A scene, and the rollouts of its figures."""

    scene: Scene
    spawn: str
    policy: str
    walkers: tuple[str, ...]
    """Policies of the figure `policies`, run under the recorded arrivals."""
    jobs: list[Job]

    @classmethod
    def of(
        cls,
        scene: Scene,
        figures: Sequence[str],
        spawn: str,
        policy: str | None,
        seeds: int,
        work: Path,
    ) -> "_Shown":
        trained = trained_policies(scene)
        best = BEST if BEST in trained else WALKERS[-1]
        walker = policy or best
        walkers = tuple(dict.fromkeys([*WALKERS, *trained, walker]))
        recorded = [("replay", name) for name in walkers if "policies" in figures]
        crowds = [(spawn, walker)] if set(figures) - {"policies"} else []
        if spawn != BASELINE and {"situations", "sheet"} & set(figures):
            crowds.append((BASELINE, walker))
        folder = work / f"figures-{scene.id}" / "rollouts"
        jobs = plan(scene.asked, scene, recorded, "full", 1, folder)
        jobs += plan(scene.asked, scene, crowds, "full", seeds, folder)
        return cls(scene, spawn, walker, walkers, jobs)

    @cached_property
    def recording(self) -> Trajectories | None:
        return recording_of(self.scene) if has_recording(self.scene) else None

    @cached_property
    def areas(self) -> Areas:
        return read_areas(self.scene)

    @property
    def plot(self) -> PlotData:
        """Plot data of both spawn models and the recording's statistics."""
        name = self._named(self.policy)
        crowds = {
            (model, name, k): crowd
            for model in dict.fromkeys((BASELINE, self.spawn))
            for k, crowd in enumerate(self._crowds(model, self.policy))
        }
        return PlotData.of(self.scene, read_reference(self.scene), crowds, "full")

    def write(self, figure: str, folder: Path) -> Path:
        """Draw a figure of this scene into a folder and return its path."""
        picture, numbers = self._draw(figure)
        about: Numbers = {"figure": figure, "scene": self.scene.id}
        if figure != "policies":
            about |= {"spawn": self.spawn, "policy": self._named(self.policy)}
        return _write(folder / f"{figure}.png", picture, about | numbers)

    def _draw(self, figure: str) -> tuple[bytes, Numbers]:
        scene, areas, policy = self.scene, self.areas, self._named(self.policy)
        if figure == "flows":
            crowds = self._crowds(self.spawn, self.policy)
            return draw_flows(scene, areas, crowds, self.recording, f"{self.spawn} × {policy}")
        assert self.recording is not None
        if figure == "policies":
            walked = {self._named(name): self._crowds("replay", name)[0] for name in self.walkers}
            return draw_policies(scene, self.recording, walked)
        models = dict.fromkeys((self.spawn, BASELINE))
        rollouts = {model: self._crowds(model, self.policy) for model in models}
        return draw_situations(scene, areas, self.recording, rollouts, policy)

    def _crowds(self, spawn: str, policy: str) -> list[Trajectories]:
        of_pair = [job for job in self.jobs if (job.spawn, job.policy) == (spawn, policy)]
        return [with_areas(read_own(job.path), self.areas) for job in of_pair]

    def _named(self, policy: str) -> str:
        return find_policy(policy, self.scene).name


def with_areas(crowd: Trajectories, areas: Areas) -> Trajectories:
    """A copy of the crowd, with the most likely areas where the scene does not have its areas."""
    known = replace(
        crowd,
        spawn_area=np.where(crowd.spawn_area < len(areas.spawn), crowd.spawn_area, -1),
        goal_area=np.where(crowd.goal_area < len(areas.goal), crowd.goal_area, -1),
    )
    return areas.assign(known)


def _write(path: Path, picture: bytes, numbers: Numbers) -> Path:
    with replacing(path) as temporary:
        temporary.write_bytes(picture)
    write_json(path.with_suffix(".json"), {"crowdbench": __version__} | numbers, compact=True)
    return path
