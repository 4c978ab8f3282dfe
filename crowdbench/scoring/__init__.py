"""Scores: the energy score, its noise floor and anchors, power, scorecards."""
