"""The page on copies: honest policies and copies in one table."""

import pytest

from studies import copies
from studies.__main__ import main as studies_main
from studies.copies import fitted

pytestmark = pytest.mark.long

WALKERS = ("straight", "exact")


def test_the_page_of_the_plaza(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    every = copies.copies_of
    monkeypatch.setattr(copies, "copies_of", lambda scene: every(scene)[:1])
    monkeypatch.setattr(copies, "HONEST", ("straight",))
    monkeypatch.setattr(copies, "DRAWS", 2)
    assert studies_main(["copies", "plaza-v0"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("# Whoever copies does not walk")
    lines = printed.splitlines()
    straight, exact = (next(r for r in lines if r.startswith(f"| {n} |")) for n in WALKERS)
    assert straight.startswith("| straight | 0.00 [0.00, 0.00] |")
    assert exact.startswith(("| exact | 1.0", "| exact | 0.9"))
    assert exact.endswith(("| 100.0 % |", " 99.9 % |"))
    perturbed = float(exact.split("|")[3].split()[0].replace("−", "-"))
    assert perturbed < 0.9


def test_a_trip_is_fitted_to_start_and_goal() -> None:
    import numpy as np

    path = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]])
    found = fitted(path, np.array([5.0, 5.0]), np.array([5.0, 8.0]))
    assert found[[0, -1]] == pytest.approx(np.array([[5.0, 5.0], [5.0, 8.0]]))
    assert found[1] == pytest.approx([4.25, 6.5])
    far = fitted(path, np.array([5.0, 5.0]), np.array([50.0, 5.0]))  # not stretched that much
    assert far[-1] == pytest.approx([7.0, 5.0])
