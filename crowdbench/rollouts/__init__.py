"""A spawn model and a policy in the simulation, from the first frame to the last."""
