"""Recordings: where they are published, and readers that make `Trajectories` of them."""
