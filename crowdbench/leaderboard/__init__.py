"""The leaderboard: submissions, their verification, and their ranks.

A submission is a folder. Neither its files nor its numbers are trusted: crowdbench
runs the rollouts itself, scores them and writes an entry. Tables and pages are drawn
from the entries alone, by `studies.site`.
"""
