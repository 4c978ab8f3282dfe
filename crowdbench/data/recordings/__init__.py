"""Recordings: where they are published, and readers that convert them to `Trajectories`."""
