"""The training scripts in the folder `baselines` of a clone.

A wheel has the scripts themselves in this place, and not this file.
"""

from pathlib import Path

__path__ = [str(Path(__file__).parents[2] / "baselines")]
