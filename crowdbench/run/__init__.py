"""Evaluation: many rollouts of spawn models and policies on a scene, and their scorecard."""
