"""`crowdbench view`: show a crowd in the viewer."""

from pathlib import Path

import crowdbench


def view(
    table: Path,
    /,
    *,
    against: str | None = None,
    scene: str | None = None,
    person: int | None = None,
    save: Path | None = None,
) -> None:
    """Show a crowd in the rerun viewer.

    Args:
        table: a rollout (.parquet); with --scene any CSV or Parquet with person_id, frame (or
            time_s), x, y
        against: crowd to show next to it on the same clock: `recording` for that of the scene, or
            another table
        scene: id of a scene, or its folder (default: the scene stated in the rollout)
        person: id of a person; shows the rays of this person's observation
        save: write FILE.rrd for `rerun FILE.rrd` instead of opening the viewer
    """
    from crowdbench import viewer

    crowd = crowdbench.read(table, scene)
    place = crowdbench.load_scene(crowd.scene if scene is None else scene)
    if scene is not None:
        crowd = _in_areas(crowd, place)
    beside = None
    if against == "recording":
        beside = crowdbench.recording_of(place)
    elif against is not None:
        beside = _in_areas(crowdbench.read(against, place), place)
    if save is not None:
        viewer.save(crowd, place, save, against=beside, person=person)
        print(f"written to {save}: open it with `rerun {save}`")
    else:
        viewer.show(crowd, place, against=beside, person=person)


def _in_areas(
    crowd: "crowdbench.Trajectories", scene: "crowdbench.Scene"
) -> "crowdbench.Trajectories":
    """The crowd in the scene's areas, by which it is coloured; tables of others have none."""
    from crowdbench.viewer.place import areas_of

    areas = areas_of(scene)
    return crowd if areas is None else areas.assign(crowd)
