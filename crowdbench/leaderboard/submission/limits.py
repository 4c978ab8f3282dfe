"""What a submission may be at most, all in one place.

The largest scene, Grand Central, has 1.3 million rows in a rollout, 12,671 persons, and weights of
5 MB: each limit leaves room for twice that.
"""

from crowdbench.policies import network

LARGEST_SUBMISSION = 200_000_000  # bytes, unpacked
LARGEST_NETWORK = network.LARGEST  # bytes, wherever a policy comes from
LARGEST_DECLARATION = 64_000  # bytes of submission.toml
MOST_DOTS = 2000
"""In submission.toml: a key of many parts, a.b.c…, takes memory by the square of their number."""
LARGEST_FITS = {".json": 1_000_000, ".safetensors": 20_000_000}  # bytes, of a spawn model
LARGEST_TABLE = 60_000_000  # bytes of a file of trajectories
LARGEST_DECODED = 300_000_000  # bytes that it may become in memory
MOST_FILES = 400
LONGEST_PATH = 100  # characters of a file's path in the submission
MOST_ROLLOUTS = 30  # of a scene, as in the protocol of most
MOST_ROWS = 2_600_000  # of a rollout
MOST_PERSONS = 30_000
MOST_COLUMNS = 64
MOST_SHOWN = 50  # problems that one message tells
"""Problems beyond these are counted only."""
