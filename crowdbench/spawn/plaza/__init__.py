"""The true process of the plaza, a synthetic place."""
