"""Submissions: `submission.toml`, models, trajectories, and their size limits."""
