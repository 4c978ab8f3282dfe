"""The study of how many rollouts a scene's scores deserve."""

from pathlib import Path

import numpy as np
import pytest

from crowdbench.evaluation import evaluate
from crowdbench.metrics import WALK
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import rows
from studies.monte_carlo import Influences, errors_of, page

PLAZA = load_scene("plaza-v0")


def drawn(rng: np.random.Generator, per_fit: int) -> Influences:
    """A score that is the mean of 3 splits, 5 fits and their rollouts, which are normal numbers."""
    splits = tuple(rng.standard_normal((5, per_fit)) for _ in range(3))
    return Influences(float(np.mean(splits)), splits, np.zeros(1000))


def test_the_error_of_rollouts_is_that_of_repeated_draws() -> None:
    rng = np.random.default_rng(0)
    each = [drawn(rng, 4) for _ in range(2000)]
    true = 1 / np.sqrt(3 * 5 * 4)
    assert np.std([of.value for of in each]) == pytest.approx(true, rel=0.05)
    assert np.sqrt(np.mean([of.of_rollouts**2 for of in each])) == pytest.approx(true, rel=0.02)


def test_as_many_rollouts_are_needed_as_make_a_third_of_the_error() -> None:
    one = drawn(np.random.default_rng(1), 6)
    blocks = np.random.default_rng(2).standard_normal(1000)
    equal = Influences(one.value, one.splits, blocks / blocks.std() * one.of_rollouts)
    assert equal.needed in (9 * 6, 9 * 6 + 1)  # rounded up
    assert Influences(one.value, one.splits, 100 * equal.blocks).needed == 2


@pytest.mark.long
def test_scores_are_those_of_an_evaluation(tmp_path: Path) -> None:
    pair = ("renewal-gmm", "straight")
    found = errors_of(PLAZA, pair, tmp_path, 1, lambda done, total: None)
    card = evaluate(
        "plaza-v0", spawn=pair[0], policy=pair[1], protocol="heldout", report=False, out=tmp_path
    )
    row = next(row for row in rows(card) if (row.spawn, row.policy) == pair)
    expected = {f: score.value for f, score in row.families.items() if f not in WALK}
    families = {family: of.value for family, of in found.items() if family != "crowd"}
    assert families == pytest.approx(expected)
    assert row.crowd is not None
    assert found["crowd"].value == pytest.approx(row.crowd.value)
    for of in found.values():
        assert 0 < of.of_rollouts < 1
        assert 0 < of.of_blocks < 1
    text = page(["plaza-v0"], [pair], out=tmp_path, workers=1)
    assert f"| plaza-v0 | renewal-gmm × straight | crowd | {row.crowd.value:.2f} | 3 |" in text
