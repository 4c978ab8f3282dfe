"""`crowdbench view` and `crowdbench record`: show a crowd in the viewer, or as a film."""

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

    crowd, place = _read(table, scene)
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


def record(
    table: Path,
    out: Path,
    /,
    *,
    scene: str | None = None,
    from_s: float = 0.0,
    length_s: float = 60.0,
    speed: float = 4.0,
) -> None:
    """Write a film of a crowd, seen from above: a GIF or an MP4.

    Args:
        table: a rollout (.parquet); with --scene any CSV or Parquet with person_id, frame (or
            time_s), x, y
        out: the film, FILE.gif or FILE.mp4; an MP4 needs the extra `video`
        scene: id of a scene, or its folder (default: the scene stated in the rollout)
        from_s: time in the crowd at which the film begins, in seconds
        length_s: length in the crowd, in seconds
        speed: how many times faster than real time the film runs
    """
    from crowdbench.cli.printing import progress_bar
    from crowdbench.viewer import film

    crowd, place = _read(table, scene)
    with progress_bar("frames") as progress:
        film.record(
            crowd, place, out,
            from_s=from_s, length_s=length_s, speed=speed, progress=progress,
        )  # fmt: skip
    print(f"written to {out}")


def _read(table: Path, scene: str | None) -> tuple["crowdbench.Trajectories", "crowdbench.Scene"]:
    """A crowd and its scene, the one that the table states if none is named."""
    crowd = crowdbench.read(table, scene)
    place = crowdbench.load_scene(crowd.scene if scene is None else scene)
    return (crowd if scene is None else _in_areas(crowd, place)), place


def _in_areas(
    crowd: "crowdbench.Trajectories", scene: "crowdbench.Scene"
) -> "crowdbench.Trajectories":
    """The crowd in the scene's areas, by which it is coloured; tables of others have none."""
    from crowdbench.viewer.place import areas_of

    areas = areas_of(scene)
    return crowd if areas is None else areas.assign(crowd)
