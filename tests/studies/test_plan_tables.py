"""The tables on companions, ways and stops."""

import pytest

from crowdbench.scene import load_scene
from studies import plans

PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module")
def held() -> dict[str, plans.Held]:
    return {h.what: h for h in plans.likelihoods(PLAZA)}


def test_held_out_people_are_likelier_than_under_the_simpler_model(
    held: dict[str, plans.Held],
) -> None:
    assert list(held) == [
        "who joins whom",
        "start, goal and speed",
        "whether people stop",
        "where and how long",
    ]
    for what in ("who joins whom", "where and how long"):  # the truth has delays and places
        assert held[what].model > held[what].simpler
    # On the plaza starts, goals and speeds are independent of each other.
    assert held["start, goal and speed"].model == pytest.approx(
        held["start, goal and speed"].simpler, abs=0.1
    )


def test_as_many_are_held_out_as_have_plans(held: dict[str, plans.Held]) -> None:
    assert 0 < held["where and how long"].number < held["whether people stop"].number
    assert held["whether people stop"].number == held["start, goal and speed"].number
    assert held["start, goal and speed"].number < held["who joins whom"].number


def test_samples_are_compared_with_the_recording() -> None:
    single, planned = ("ntpp-gmm", "straight"), ("cox-plans", "straight")
    shown = {s.metric: s for s in plans.statistics(PLAZA, [single, planned], seeds=2)}
    assert set(shown) == set(plans.SHOWN)
    for each in shown.values():
        assert each.low <= each.recorded <= each.high
        found = {pair: len(values) for pair, values in each.sampled.items()}
        assert found == {single: 2, planned: 2}
    standing = shown["standing_share"]
    assert max(standing.sampled[single]) < standing.low < min(standing.sampled[planned])


def test_walkers_are_those_that_the_scene_has() -> None:
    assert plans.pairs_of(PLAZA) == list(plans.PAIRS[:3])
    assert plans.pairs_of(load_scene("eth-v0")) == list(plans.PAIRS)


def test_the_page_says_how_it_was_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "PAIRS", (("ntpp-gmm", "straight"),))
    page = plans.page(["plaza-v0"], seeds=2)
    assert "\n    python -m studies plans plaza-v0\n" in page
    assert page.count("\n| --- |") == 2
