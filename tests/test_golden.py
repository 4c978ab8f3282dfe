"""Files written by earlier versions are still read. A change here needs a line in CHANGELOG."""

from pathlib import Path

import numpy as np

from crowdbench.evaluation import read_scorecard
from crowdbench.tables import read_own

GOLDEN = Path(__file__).parent / "golden"


def test_yesterdays_rollout_is_read() -> None:
    crowd = read_own(GOLDEN / "rollout-1.parquet")
    assert (crowd.scene, crowd.dt_s, crowd.frames) == ("plaza-v0", 0.4, 50)
    assert crowd.provenance == {"spawn": "poisson-gmm", "policy": "straight", "seed": 1}
    assert len(crowd) == 19
    assert crowd.entered.sum() == 10
    np.testing.assert_allclose(crowd.start[0], [9.54023, 9.270081], atol=1e-5)


def test_yesterdays_scorecard_is_read() -> None:
    card = read_scorecard(GOLDEN / "scorecard-1.json")
    assert (card.scene, card.blocks) == ("eth-v0", 17)
    (entry,) = card.entries
    assert (entry.spawn, entry.policy, entry.seeds) == ("poisson-gmm", "social-force", [*range(6)])
    assert len(entry.metrics["dwell"].distances) == 6
