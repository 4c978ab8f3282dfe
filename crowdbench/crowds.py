"""Crowds as a user names them: rolled out by names, read from a file of some scene, and scored.

The parts that work on objects are `crowdbench.rollouts.rollout` and
`crowdbench.trajectories.storage`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.scene import Scene, load_scene
from crowdbench.trajectories import storage
from crowdbench.trajectories.table import Trajectories

if TYPE_CHECKING:
    from crowdbench.metrics import MetricResult
    from crowdbench.policies import Policy
    from crowdbench.simulation import Settings
    from crowdbench.spawn import SpawnModel
    from crowdbench.spawn.model import Start


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
    """Let `spawn` people a scene and `policy` walk them for `horizon_s` seconds.

    The same seed gives the same table. Models may be given by name; of one with several fits that
    is the first, fitted to the whole recording (`spawn_model(…, part=…, fit=…)` gives the others).

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a scene.
        spawn: who enters when and where: a name, `pkg.module:Class`, or a model.
        policy: who walks them: a name, `pkg.module:Class`, an ONNX file, or a policy. One that
            sees observations may say which, by its attributes `observation` (`lidar-2` by
            default), `rays` and `ray_range_m`.
        seed: of all that is left to chance.
        horizon_s: length in seconds, by default the recording's.
        start: `stationary` (after a discarded warm-up), `recorded` (replay only) or `empty`; by
            default the spawn model's own.
        settings: of the simulation, by default what the policy asks for.

    Raises:
        SceneError, SettingError, WeightsError, RecordingError: what was asked for does not exist
            or does not fit, or nobody came.
        ActionError: the policy does not give one finite action per person.
        CapacityError: more people than slots.
    """
    from crowdbench import registry
    from crowdbench.rollouts.episode import check_horizon
    from crowdbench.rollouts.rollout import rollout as roll_out

    place = load_scene(scene)
    if horizon_s is not None:
        check_horizon(horizon_s)
    return roll_out(
        place,
        registry.spawn_model(spawn, place),
        registry.policy(policy, place),
        seed=seed,
        horizon_s=horizon_s,
        start=start,
        settings=settings,
    )


def score(
    scene: str | Path | Scene, crowd: Trajectories, *, against: Trajectories | None = None
) -> dict[str, "MetricResult"]:
    """Score any simulator's crowd against a scene's recording, or against another crowd.

    Gives the result of each metric that the scene's time blocks can tell something by, by name.
    With `against`, that crowd takes the place of the recording: its values are the `recorded`
    ones, and distances are divided by its means.

    A crowd is a continuous run as long as the recording, its first frame being frame 0: it is
    looked at in the same time blocks. A table does not tell an empty scene at its end from an
    end that came early; up to one time block is taken for empty. More than a block shorter or
    longer is refused. Persons without areas are given the likeliest ones. Metrics that others have
    registered are computed where the scene's recording is imported.

    Raises:
        SceneError: there is no such scene.
        WeightsError: the scene has no reference statistics.
        RecordingError: a crowd is another scene's, or its time step or length is not the
            scene's.
    """
    from crowdbench.scoring.reference import applicable, read_reference, score_against

    place = load_scene(scene)
    reference = read_reference(place)
    if against is None and len(reference.statistics) < len(applicable(reference.blocks)):
        # Only then: it loads the simulation, which scoring a table does not need.
        from crowdbench.evaluation.references import reference_of

        reference = reference_of(place)
    return score_against(reference, place, crowd, against)


def read(path: str | Path, scene: str | Path | Scene | None = None) -> Trajectories:
    """Read a Parquet or CSV table of trajectories, crowdbench's own or another simulator's.

    A file that crowdbench wrote knows its scene. Another's needs the columns `person_id`, `x`,
    `y` (metres) and `frame` or `time_s` (seconds, on the frames of the scene), and may have the
    others of `Trajectories`.

    Args:
        path: a `.parquet` or `.csv`.
        scene: whose crowd it is: an id from `list_scenes()`, a folder with a `scene.toml`, or a
            scene. Needed for another program's table.

    Raises:
        RecordingError: the file is missing, is no table, lacks a column, holds values that
            are not finite, or belongs to another scene or time step.
        SceneError: there is no such scene.
    """
    if scene is None:
        return storage.read_own(path)
    place = load_scene(scene)
    return storage.read(path, scene=place.id, dt_s=place.dt_s)
