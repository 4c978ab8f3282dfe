"""What is fitted of the guided walker in a place."""

from dataclasses import replace
from pathlib import Path

import pytest

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct
from crowdbench.policies import GuidedWalker
from crowdbench.policies.guided import ANYWHERE, FILE, Fits, parameters_of
from crowdbench.run.validation import Validation, Validator
from crowdbench.scene import load_scene
from crowdbench.scene_building.walker import fit_walker, fitted

PLAZA = load_scene("plaza-v0")
FAR = ANYWHERE._replace(speed_mps=0.5, side_mps=0.03, bow=0.02)


class Known(Validator):
    """Stands for a place whose people have known accelerations, deviations and walls."""

    def __init__(self, *, wall: float | None = None) -> None:
        self.wall = wall

    def judges(self, metric: str) -> bool:
        return self.wall is not None

    def validate(self, policy: GuidedWalker, *, rollouts: int = 1) -> Validation:
        of = policy.parameters
        ratios = {
            "acceleration": of.speed_mps / 0.12,
            "turning": of.side_mps / 0.2,
            "deviation": (0.3 + of.bow / 0.05) / 1.3,
        }
        near = {} if self.wall is None else {"wall_clearance": -abs(of.wall - self.wall)}
        return Validation(near, {}, 1.0, 1.0, 1.0, ratios, ((), ()), passes=True)


def test_people_become_as_unsteady_as_recorded_ones() -> None:
    found = fitted(Known(), FAR)
    assert found.speed_mps == pytest.approx(0.12, rel=0.02)
    assert found.side_mps == pytest.approx(0.2, rel=0.02)
    assert found.bow == pytest.approx(0.05, rel=0.05)
    assert found._replace(speed_mps=0.5, side_mps=0.03, bow=0.02) == FAR


def test_the_cost_of_walls_with_the_best_score_is_taken() -> None:
    assert fitted(Known(wall=9.0)).wall == 8.0
    assert fitted(Known(wall=50.0)).wall == 64.0


@pytest.mark.long
def test_on_the_plaza_people_walk_as_unsteadily_as_recorded() -> None:
    validator = Validator(PLAZA, "fold1")
    before = validator.validate(GuidedWalker(FAR)).ratios
    after = validator.validate(GuidedWalker(fitted(validator, FAR))).ratios
    for name in ("acceleration", "turning"):
        assert abs(after[name] - 1) < 0.15 < abs(before[name] - 1)


def test_the_file_has_parameters_for_each_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from crowdbench.scene_building import walker

    monkeypatch.setattr(
        walker, "Validator", lambda _, split: Known(wall=9.0 if split == "full" else 50.0)
    )
    place = replace(PLAZA, folder=tmp_path)
    fit_walker(place, elsewhere=FAR, command="this", workers=1)
    fits = read_struct(tmp_path / FILE, Fits, WeightsError, "")
    assert set(fits.splits) == {"full", "fold0", "fold1", "fold2"}
    assert fits.elsewhere == FAR._asdict()
    assert fits.command == "this"
    assert parameters_of(place, "full").wall == 8.0
    assert parameters_of(place, "fold2").wall == 64.0
