"""The search of what the guided walker has in common everywhere."""

from collections.abc import Sequence

import numpy as np
import pytest

from crowdbench.baselines import guided
from crowdbench.baselines.guided import LOCAL, SHARED, Place, main, searched, value
from crowdbench.policies.guided import ANYWHERE, Parameters
from crowdbench.run.validation import Validation


def validation(interaction: float, motion: float = 0.5, *, passes: bool = True, **ratios: float):
    families = {"motion": motion, "interaction": interaction}
    return Validation({}, families, 1.0, 1.0, 1.0, ratios, ((), ()), passes=passes)


def test_a_place_counts_interaction_companions_and_the_gate() -> None:
    assert value(validation(0.6)) == pytest.approx(0.85)
    assert value(validation(0.6, -3.0)) == pytest.approx(0.6)
    assert value(validation(0.6, passes=False)) == pytest.approx(-0.15)
    apart = validation(0.6, companion_distance=np.e, companion_offset=1.0, overlap_rate=1.0)
    assert value(apart) == pytest.approx(0.85 - 1 / 6)
    assert np.isfinite(value(validation(0.6, overlap_rate=0.0)))


class Known(Place):
    """Stands for a place that likes certain shared."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.likes = np.log([(low * high) ** 0.5 for low, high in SHARED.values()]) + 0.1
        self.local = ANYWHERE._replace(bow=0.02 if name == "a" else 0.08)
        self.walked = 0

    def walk(self, shared: Sequence[float]) -> Validation:
        self.walked += 1
        off = np.log(shared) - self.likes
        return validation(float(1 - off @ off))


def test_shared_are_found_and_local_parameters_are_medians() -> None:
    places = [Known("a"), Known("b"), Known("c")]
    told: list[str] = []
    found = searched(places, candidates=60, seed=0, tell=told.append)
    shared = np.log([getattr(found, name) for name in SHARED])
    assert np.abs(shared - places[0].likes).mean() < 0.2
    assert found.bow == pytest.approx(0.08)
    assert len(told) == 61
    assert places[1].walked == 61
    assert {*SHARED, *LOCAL} | {"speed_s", "side_s"} == {*Parameters._fields}


@pytest.mark.long
def test_the_scene_itself_has_no_part_in_its_shared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    walked: dict[str, int] = {}
    wrote: dict[str, Parameters] = {}

    class Counted(Known):
        def walk(self, shared: Sequence[float]) -> Validation:
            walked[self.name] = walked.get(self.name, 0) + 1
            return super().walk(shared)

    monkeypatch.setattr(guided, "Place", Counted)
    monkeypatch.setattr(
        guided, "fit_walker", lambda scene, *, elsewhere, **_: wrote.update({scene.id: elsewhere})
    )
    main(["--scenes", "eth-v0", "--candidates", "8"])
    assert set(walked) == {"hotel-v0", "zara1-v0", "gc-v0", "forum-v0"}
    assert set(wrote) == {"eth-v0"}
    assert "places: hotel-v0, zara1-v0, gc-v0, forum-v0" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["--candidates", "3"])
