"""Crowds in the rerun viewer: people, trails, rays, areas, plots and a log, on a common time line.

`crowdbench.viewer.film` makes films, without rerun.

Imported only when needed, by the command line and by environments with a render mode. Modules that
need rerun are imported only where it is certain to be installed.
"""

from pathlib import Path

from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.scene import Scene, load_scene
from crowdbench.viewer.access import check_rerun, check_screen


def save(
    crowd: Trajectories,
    scene: str | Path | Scene,
    path: str | Path,
    *,
    against: Trajectories | None = None,
    person: int | None = None,
) -> None:
    """Write a file that `rerun FILE.rrd` opens. An incomplete file is never left behind.

    Args:
        crowd: the trajectories to show.
        scene: their scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        path: the file, usually with the suffix `.rrd`.
        against: another crowd, usually the recording, shown beside it on the same time line.
        person: id of a person in `crowd` whose rays and complete path are also shown.

    Raises:
        SettingError: rerun is not installed, or no person has this id.
        SceneError: there is no such scene.
        OutputError: the file cannot be written.
    """
    check_rerun()
    from crowdbench.viewer.finished import packed

    data = packed(crowd, load_scene(scene), against, person)
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(data)


def show(
    crowd: Trajectories,
    scene: str | Path | Scene,
    *,
    against: Trajectories | None = None,
    person: int | None = None,
) -> None:
    """Show a crowd in the viewer that is open, or in a new window; arguments as for `save`.

    Raises:
        SettingError: rerun is not installed, there is no screen, or no person has this id.
        SceneError: there is no such scene.
    """
    check_rerun()
    from crowdbench.viewer import finished

    finished.show(crowd, load_scene(scene), against, person)


__all__ = ["check_screen", "save", "show"]
