"""The walk score on training blocks, with which settings of policies are chosen."""

from dataclasses import replace

import numpy as np
import pytest

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import SettingError
from crowdbench.metrics.rows import block_of_frames
from crowdbench.policies import Straight
from crowdbench.run import validation
from crowdbench.run.validation import Validation, Validator, validate
from crowdbench.scene import load_scene

PLAZA = load_scene("plaza-v0")


class Slow(Straight):
    """Walks straight at half of the preferred speed."""

    name = "slow"

    def act(self, seen):
        return 0.5 * super().act(seen)


@pytest.fixture(scope="module")
def full() -> Validation:
    """Of a policy that is too slow, on all blocks."""
    return validate("plaza-v0", Slow(), "full")


def test_recorded_people_score_about_1_and_straight_walkers_0() -> None:
    recorded = validate(PLAZA, "recorded-paths", "fold1")
    assert recorded.walk > 0.9
    assert recorded.passes
    assert recorded.speed_mps == pytest.approx(recorded.recorded_speed_mps, rel=0.02)
    assert recorded.companion_distance == pytest.approx(1.0, abs=0.05)
    straight = validate(PLAZA, Straight(), "fold1")
    assert set(straight.scores.values()) == {0.0}
    assert straight.walk == 0.0


def test_who_does_not_pass_the_gate_has_no_positive_score(full: Validation) -> None:
    assert not full.passes
    assert full.walk <= 0
    assert full.speed_mps < 0.7 * full.recorded_speed_mps


def test_the_blocks_that_a_fold_is_scored_on_do_not_count(full: Validation, monkeypatch) -> None:
    """Neither where people are in them, nor how trips end there."""
    plain = validate(PLAZA, Slow(), "fold0")
    blocks = validation.reference_of(PLAZA).blocks.scored("fold0")
    disturbed_positions = 0

    def disturbed(crowd: Trajectories) -> Trajectories:
        nonlocal disturbed_positions
        block = block_of_frames(blocks, crowd.frames)
        inside, ends = block[crowd.row_frame()] >= 0, block[crowd.last] >= 0
        disturbed_positions += inside.sum()
        noise = np.random.default_rng(0).normal(0, 3, crowd.xy.shape).astype(np.float32)
        return replace(
            crowd,
            xy=np.where(inside[:, None], crowd.xy + noise, crowd.xy),
            outcome=np.where(ends, OUTCOMES.index("exit"), crowd.outcome).astype(np.int8),
        )

    walk, walk_several = validation.rollout, validation.roll_out
    recorded = validation.registry.recording_of(PLAZA)
    arrivals = validation.registry.spawn_model("replay", PLAZA)
    monkeypatch.setattr(validation, "rollout", lambda *a, **k: disturbed(walk(*a, **k)))
    monkeypatch.setattr(
        validation, "roll_out", lambda *a, **k: [disturbed(c) for c in walk_several(*a, **k)]
    )
    monkeypatch.setattr(validation.registry, "recording_of", lambda _: disturbed(recorded))
    monkeypatch.setattr(validation.registry, "spawn_model", lambda *_: arrivals)
    assert validate(PLAZA, Slow(), "fold0") == plain
    assert disturbed_positions > 1000
    assert plain != full  # nor are the results those of all blocks
    assert validate(PLAZA, Slow(), "full") != full


def test_shares_of_distances_to_walls_explain_the_score_of_them() -> None:
    """The score is that of the Wasserstein distance of the two distributions."""
    distance_m = {}
    for policy in ("straight", "social-force"):
        found = validate(PLAZA, policy, "fold2")
        np.testing.assert_allclose(np.sum(found.clearance, axis=1), 1.0)
        recorded, simulated = np.cumsum(found.clearance, axis=1)
        distance_m[policy] = 0.05 * np.abs(simulated - recorded).sum()
    assert found.scores["wall_clearance"] == pytest.approx(
        1 - distance_m["social-force"] / distance_m["straight"], abs=1e-6
    )


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"rollouts": 0}, "rollouts"),
        ({"split": "fold9"}, "split"),
        ({"policy": "nobody"}, "policy"),
    ],
)
def test_bad_settings(wrong: dict, named: str) -> None:
    with pytest.raises(SettingError, match=named):
        validate(PLAZA, **({"policy": Straight()} | wrong))


def test_with_a_horizon_only_its_blocks_count() -> None:
    short = Validator(PLAZA, "fold0", horizon_s=600.0)
    blocks = validation.reference_of(PLAZA).blocks.training("fold0")
    assert 0 < len(short._blocks) < len(blocks)
    assert (short._blocks.frames[:, 1] <= PLAZA.frames(600.0)).all()
    found = short.validate(Slow())
    assert found.speed_mps < 0.7 * found.recorded_speed_mps
    assert short.validate(Straight()).walk == 0.0
    with pytest.raises(SettingError, match=r"horizon_s: got 1; .* in which a block ends"):
        Validator(PLAZA, "fold0", horizon_s=1.0)
