"""Creation of scenes from users' own recordings, and consistency checks of scenes."""

from crowdbench.scene_building.check import check_scene
from crowdbench.scene_building.create import NewScene, create_like, create_scene

__all__ = ["NewScene", "check_scene", "create_like", "create_scene"]
