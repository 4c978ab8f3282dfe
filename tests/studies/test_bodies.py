"""The pages on bodies and on the exam."""

import numpy as np
import pytest

from crowdbench.data.table import from_rows
from crowdbench.scene import load_scene
from studies.bodies import close_rows, page, scores, with_radius
from studies.exam import page as exam_page


def test_positions_near_strangers_and_near_companions_are_counted() -> None:
    # Two companions 0.2 m apart; a stranger 0.25 m from one of them in the first of two frames.
    xy = np.array([[0, 0], [0, 0], [0.2, 0], [0.2, 0], [0.45, 0], [3, 0]], float)
    crowd = from_rows(
        scene="x", dt_s=0.4, person_id=np.repeat([0, 1, 2], 2), frame=np.tile([0, 1], 3), xy=xy,
        persons={"group": np.repeat([7, 7, -1], 2)}, where="test",
    )  # fmt: skip
    assert close_rows(crowd, 0.3) == pytest.approx((2 / 6, 4 / 6))
    assert close_rows(crowd, 0.22) == pytest.approx((0, 4 / 6))
    assert close_rows(crowd, 0.1) == (0, 0)


@pytest.mark.nightly
def test_the_page_has_the_shares_that_people_keep() -> None:
    plaza = load_scene("plaza-v0")
    text = page(["plaza-v0"])
    kept = scores(with_radius(plaza, 0.15))["motion"] / scores(with_radius(plaza, 0.0))["motion"]
    line = next(row for row in text.splitlines() if row.startswith("| plaza-v0 | 0.15 |"))
    assert f"{kept:.3f}" in line
    assert line.endswith("| no |")


@pytest.mark.nightly
def test_the_page_of_the_exam_has_verdicts_and_values() -> None:
    text = exam_page(["straight"], workers=1)
    assert (
        "| [Walking speed in a corridor](#walking-speed-in-a-corridor) | RiMEA 1 | passed |" in text
    )
    assert "| time, s | 26 to 34 | 30.1 |" in text
    assert "## Flow through a door" in text
    assert "- RiMEA 2, 3, 13" in text
