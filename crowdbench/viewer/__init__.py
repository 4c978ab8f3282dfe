"""Crowds in the rerun viewer: people, trails, rays, areas, plots and a log, on a common time line.

Imported only when needed, by the command line and by environments with a render mode.
"""

from crowdbench.viewer.access import check_screen
from crowdbench.viewer.finished import save, show

__all__ = ["check_screen", "save", "show"]
