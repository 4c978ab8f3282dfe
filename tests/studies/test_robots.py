"""The page of robots says what its ranks say."""

from studies.robots import finding


def test_robots_that_change_places_with_the_people_are_named() -> None:
    text = finding({
        "straight": {"a": 1, "b": 2, "c": 3},
        "replay": {"a": 2, "b": 1, "c": 2},
    })  # fmt: skip
    assert "a among people who see nobody; b among people as recorded" in text
    assert "This pair changes its order with the people: a–b." in text
    assert "One of 3 pairs differs significantly among some people only." in text
    assert text.endswith("holds for the people that it was measured among.")


def test_the_same_ranks_everywhere_are_said_to_be_so() -> None:
    text = finding({kind: {"a": 1, "b": 1, "c": 3} for kind in ("straight", "replay")})
    assert "Among people of all kinds, a and b come first." in text
    assert text.endswith("The ranks are the same among all people.")
