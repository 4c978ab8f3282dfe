"""Files written by earlier versions are still read. A change here needs a line in CHANGELOG."""

from pathlib import Path

import msgspec
import numpy as np

from crowdbench.data.storage import read_own
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.scorecard import Scorecard

GOLDEN = Path(__file__).parent / "golden"


def test_yesterdays_rollout_is_read() -> None:
    crowd = read_own(GOLDEN / "rollout-1.parquet")
    assert (crowd.scene, crowd.dt_s, crowd.frames) == ("plaza-v0", 0.4, 50)
    assert crowd.provenance == {"spawn": "poisson-gmm", "policy": "straight", "seed": 1}
    assert len(crowd) == 19
    assert crowd.entered.sum() == 10
    np.testing.assert_allclose(crowd.start[0], [9.54023, 9.270081], atol=1e-5)


def test_yesterdays_scorecard_is_read_and_ranked() -> None:
    card = msgspec.json.decode((GOLDEN / "scorecard-4.json").read_bytes(), type=Scorecard)
    assert (card.scene, card.protocol, card.blocks, card.rollouts) == ("eth-v0", "full", 17, 30)
    entry, walk, *anchors = rows(card)
    assert (entry.spawn, entry.policy, entry.rank) == ("renewal-gmm", "straight", 1)
    assert entry.overall is not None
    assert round(entry.overall.value, 2) == 0.35
    assert walk.spawn == "replay"
    assert len(anchors) == 6
