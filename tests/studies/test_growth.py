"""How cost grows: the tables, and the page made of them, from tiny measurements."""

import numpy as np
import pytest

from studies import growth, growth_page


@pytest.mark.long
def test_the_page_has_all_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (
        ("MEASURE_S", 0.01), ("SIDES", (1, 2)), ("BOXES", (0, 10)), ("ROLLOUTS", (1, 2)),
        ("CITY", 200), ("CITY_S", 24.0), ("STREETS", 3),
    ):  # fmt: skip
        monkeypatch.setattr(growth, name, value)
    monkeypatch.setattr(growth, "_threads", lambda: [1])
    small = list(growth.tables(people=(5, 10), worlds=(1, 2)))
    monkeypatch.setattr(growth_page, "tables", lambda: iter(small))
    text = "\n".join(growth_page.page())
    assert text.count("\n## ") == len(small) + 1 == 8
    assert "| 10 |" in text
    assert "social-force" in text
    assert "a million rollouts" in text
    for measured in small:
        for row in measured.rows:
            assert all(value > 0 for value in row.figures.values()), (measured.title, row)


def test_the_city_has_streets_between_its_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "CITY", 300)
    scene = growth.city()
    events = growth.Citizens().sample(60.0, scene, np.random.default_rng(0))
    assert len(events) == 300
    assert scene.walkable(events.start.astype(float)).all()
    assert scene.walkable(events.goal.astype(float)).all()
