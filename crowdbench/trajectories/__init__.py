"""Trajectories of people, recorded or simulated: the table, its files and its time blocks."""

from crowdbench.trajectories.table import OUTCOMES, Trajectories

__all__ = ["OUTCOMES", "Trajectories"]
