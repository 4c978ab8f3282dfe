"""Comparison of a scene's crowd with and without a scenario: tables and pictures."""
