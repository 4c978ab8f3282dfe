"""Crowds in the rerun viewer: people, trails, rays and areas, plots and a log, on one clock.

Nobody imports it but the command line and an environment that is asked to render, and they only
when they need it.
"""

from crowdbench.viewer.access import check_screen
from crowdbench.viewer.finished import save, show

__all__ = ["check_screen", "save", "show"]
