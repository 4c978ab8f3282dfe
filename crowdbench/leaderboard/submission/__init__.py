"""What participants send: `submission.toml`, models, trajectories, and their limits."""
