"""Scoring: energy scores, noise floor, anchors, power study and scorecards."""
