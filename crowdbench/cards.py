"""Short import path for `crowdbench.scoring.ranking`."""

from crowdbench.scoring.ranking import rows as rows
