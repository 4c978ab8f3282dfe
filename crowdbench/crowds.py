"""The user-facing functions `rollout`, `read` and `score`, which accept names as well as objects.

`crowdbench.run.rollout` and `crowdbench.data.storage` hold the functions that take
objects only.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.data import storage
from crowdbench.data.table import Trajectories
from crowdbench.errors import check_seed, checked
from crowdbench.scene import Scene, load_scene

if TYPE_CHECKING:
    from crowdbench.metrics import MetricResult
    from crowdbench.policies import Policy
    from crowdbench.scoring.scorecard import Scorecard
    from crowdbench.simulation import Settings
    from crowdbench.spawn import SpawnModel
    from crowdbench.spawn.model import Start


@checked(
    "crowdbench.spawn:SpawnModel",
    "crowdbench.policies:Policy",
    "crowdbench.spawn.model:Start",
    "crowdbench.simulation:Settings",
)
def rollout(
    scene: str | Path | Scene,
    spawn: "str | SpawnModel",
    policy: "str | Policy",
    *,
    seed: int,
    horizon_s: float | None = None,
    start: "Start | None" = None,
    settings: "Settings | None" = None,
) -> Trajectories:
    """Simulate a crowd: `spawn` draws the arrivals and `policy` moves the people.

    Returns the trajectories of `horizon_s` seconds. The same seed gives the same table. A model
    given by name is its first fit to the whole recording; `spawn_model(…, split=…, fit=…)` returns
    the other fits.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        spawn: the spawn model: a name, `pkg.module:Class`, or an object.
        policy: the policy: a name, `pkg.module:Class`, an ONNX file, or an object. A policy with
            `sees = "observation"` may choose its observation by the attributes `observation`
            (default `lidar-2`), `rays` and `ray_range_m`.
        seed: seed of all random draws.
        horizon_s: length in seconds; default: the length of the recording.
        start: `stationary` (after a discarded warm-up), `recorded` (replay only) or `empty`;
            default: the spawn model's attribute `start`.
        settings: settings of the simulation, such as `Settings(max_alive=500)`. The observation is
            that of the policy; if the settings name one, it must be the same.

    Raises:
        SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or recording
            does not exist or does not fit, an argument has a wrong type, or nobody entered.
        ActionError: the policy does not return one finite action per person.
        CapacityError: there are more people than slots.
    """
    from crowdbench import registry
    from crowdbench.run.rollout import rollout as roll_out

    check_seed(seed)
    place = load_scene(scene)
    return roll_out(
        place,
        registry.spawn_model(spawn, place),
        registry.policy(policy, place),
        seed=seed,
        horizon_s=horizon_s,
        start=start,
        settings=settings,
    )


@checked()
def score(
    scene: str | Path | Scene, crowd: Trajectories, *, against: Trajectories | None = None
) -> dict[str, "MetricResult"]:
    """Compare the crowd of any simulator with a scene's recording, or with another crowd.

    Returns the result of each metric by name, for the metrics that apply to the scene's time
    blocks. If `against` is given, it replaces the recording: the `recorded` values of the results
    are those of `against`, and distances are divided by its means.

    A crowd must be one continuous run that starts at frame 0 and is as long as the recording,
    because both are compared in the same time blocks. A table cannot show whether it ends early
    or whether the scene is empty at its end: a missing end of up to one time block counts as
    empty. A crowd that is more than one block shorter or longer is rejected. People without areas
    are assigned to the most likely ones. Registered metrics of other packages are computed only
    if the scene's recording is imported.

    Raises:
        SceneError: the scene does not exist.
        WeightsError: the scene has no reference statistics.
        RecordingError: a crowd belongs to another scene, or its time step or length differs from
            the scene's.
    """
    from crowdbench.scoring.reference import applicable, read_reference, score_against

    place = load_scene(scene)
    reference = read_reference(place)
    if against is None and len(reference.statistics) < len(applicable(reference.blocks)):
        # Imported only if needed: it loads the simulation, which scoring a table does not use.
        from crowdbench.run.references import reference_of

        reference = reference_of(place)
    return score_against(reference, place, crowd, against)


@checked()
def score_rollouts(
    scene: str | Path | Scene, crowds: Sequence[Trajectories], *, recorded_arrivals: bool = False
) -> "Scorecard":
    """Score several rollouts of any simulator against the anchors of a scene.

    The scorecard has one entry, called `trajectories`, under the protocol `full`. It is scored on
    arrivals, presence, trips and space, which needs at least two rollouts.

    With `recorded_arrivals`, people must enter at the recorded times and places, and how they walk
    is scored too: motion and interaction. One rollout is enough for a deterministic simulator.
    People get the goals of the recorded people whom they stand for; who leaves within 1 m of it has
    arrived, if the table has no `outcome`. See `score` for what a crowd has to be.

    Raises:
        SceneError: the scene does not exist.
        SettingError: there are no crowds.
        WeightsError: the scene has no reference statistics or anchors.
        RecordingError: a crowd belongs to another scene, or its time step or length differs from
            the scene's; or, with `recorded_arrivals`, people do not enter as recorded, or the
            recording is not imported.
    """
    from crowdbench.run.judge import judge_crowds
    from crowdbench.run.references import reference_of

    place = load_scene(scene)
    return judge_crowds(place, reference_of(place), crowds, recorded_arrivals=recorded_arrivals)


@checked()
def read(path: str | Path, scene: str | Path | Scene | None = None) -> Trajectories:
    """Read a Parquet or CSV table of trajectories, written by crowdbench or another program.

    A file written by crowdbench contains its scene. A table of another program needs the columns
    `person_id`, `x`, `y` (metres) and `frame` or `time_s` (seconds, at the frames of the scene).
    It may have the other columns of `Trajectories`.

    Args:
        path: a `.parquet` or `.csv` file.
        scene: the scene of the crowd: an id from `list_scenes()`, a folder with a `scene.toml`,
            or a `Scene`. Required for tables of other programs.

    Raises:
        RecordingError: the file is missing, is not a table, lacks a column, contains values that
            are not finite, or belongs to another scene or time step.
        SceneError: the scene does not exist.
    """
    if scene is None:
        return storage.read_own(path)
    place = load_scene(scene)
    return storage.read(path, scene=place.id, dt_s=place.dt_s)
