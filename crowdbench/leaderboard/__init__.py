"""The leaderboard: submissions, their verification, and the pages that show them.

A submission is a folder. Neither its files nor its numbers are trusted: crowdbench
runs the rollouts itself, scores them and writes an entry. The pages are generated from the entries
alone.
"""
