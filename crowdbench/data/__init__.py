"""Recorded or simulated trajectories: the table, its file formats, and time blocks."""

from crowdbench.data.table import OUTCOMES, Trajectories

__all__ = ["OUTCOMES", "Trajectories"]
