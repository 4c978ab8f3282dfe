"""What a right model would score in walking."""

from dataclasses import replace
from pathlib import Path

import pytest

from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import write_json
from crowdbench.report.text.notes import ceiling_notes
from crowdbench.scene import load_scene
from crowdbench.scoring.ceilings import FILE, Ceiling, Ceilings, read_ceilings
from studies.ceilings import measure, write

PLAZA = load_scene("plaza-v0")
OF = Ceiling(metrics={"pace": 0.4}, families={"motion": 0.4, "interaction": 0.7}, walk=0.4)


def test_shipped_ceilings_are_below_one_and_fit_their_scenes() -> None:
    for name in ("eth-v0", "gc-v0", "forum-v0", "hotel-v0", "zara1-v0"):
        scene = load_scene(name)
        found = read_ceilings(scene)
        assert found is not None
        for of in (found.recorded, found.perturbed):
            assert set(of.metrics) <= set(scene.protocol.scored)
            assert of.walk == min(of.families.values()) < 1


@pytest.mark.long
def test_a_policy_that_draws_much_would_get_less(tmp_path: Path) -> None:
    """People of a policy that draws its steps at random are not even like themselves."""
    with pytest.raises(SettingError, match="which draws no random numbers"):
        measure(PLAZA, "straight", tmp_path, 1, lambda done, total: None)
    found = measure(PLAZA, "random", tmp_path, 1, lambda done, total: None)
    assert set(found.recorded.families) == {"motion", "interaction"}
    place = replace(PLAZA, folder=tmp_path)
    assert read_ceilings(place) is None
    write(place, found)
    assert read_ceilings(place) == found


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    place = replace(PLAZA, folder=tmp_path)
    (tmp_path / FILE).write_text("{}")
    with pytest.raises(WeightsError, match="python -m studies ceilings"):
        read_ceilings(place)


def test_notes_take_those_of_the_arrivals(tmp_path: Path) -> None:
    place = replace(PLAZA, folder=tmp_path)
    more = Ceiling(metrics={}, families={"motion": 0.9}, walk=0.9)
    write_json(
        tmp_path / FILE,
        Ceilings(command="made by hand", policy="anticipate", recorded=OF, perturbed=more),
    )

    def said(*spawn: str) -> str:
        return " ".join(ceiling_notes(spawn, place))

    assert "about 0.40 here (motion 0.40, interaction 0.70)" in said("replay", "poisson-gmm")
    assert "about 0.90 here" in said("perturbed-replay")
    assert said("poisson-gmm") == ""
