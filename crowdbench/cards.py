"""`crowdbench.scoring.scorecard` by its short name."""

from crowdbench.scoring.scorecard import rows as rows
