"""Size limits of submissions.

The largest scene, Grand Central, has 1.3 million rows and 12,671 persons in a rollout, and weights
of 5 MB. Each limit allows at least twice that.
"""

LARGEST_SUBMISSION = 200_000_000  # bytes of all files
LARGEST_DECLARATION = 64_000  # bytes of submission.toml
MOST_DOTS = 2000
"""Dots in submission.toml: memory use is quadratic in the number of parts of a key a.b.c…"""
LARGEST_FITS = {".json": 1_000_000, ".safetensors": 20_000_000}  # bytes of a spawn model's file
LARGEST_TABLE = 60_000_000  # bytes of a trajectory file
LARGEST_DECODED = 300_000_000  # bytes of its table in memory
MOST_FILES = 400
LONGEST_PATH = 100  # characters of a file's path in the submission
MOST_ROLLOUTS = 30  # per scene, as in the protocol of most scenes
MOST_ROWS = 2_600_000  # per rollout
MOST_PERSONS = 30_000
MOST_COLUMNS = 64
MOST_SHOWN = 50  # problems printed in one message
"""Further problems are only counted."""
