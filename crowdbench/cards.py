"""Short import path for `crowdbench.scoring.scorecard`."""

from crowdbench.scoring.scorecard import rows as rows
