"""Creation of scenes from users' own recordings, and consistency checks of scenes."""

from crowdbench.scene_building.check import Finding, check_scene
from crowdbench.scene_building.create import Created, check_new, create_like, create_scene
from crowdbench.scene_building.walls import read_walls

__all__ = [
    "Created",
    "Finding",
    "check_new",
    "check_scene",
    "create_like",
    "create_scene",
    "read_walls",
]
