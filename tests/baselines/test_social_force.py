"""The search of the parameters of social forces and of the speed model."""

import json
from pathlib import Path

import numpy as np
import pytest

from crowdbench.baselines import social_force
from crowdbench.baselines.social_force import MODELS, Judge, Tried, main, search
from crowdbench.exam import exam
from crowdbench.policies import speed_model


def near(parameters: tuple[float, ...]) -> Tried:
    """A candidate that is the better the nearer it is to a hidden one."""
    model = MODELS["speed-model"]
    hidden = np.log(model.ranges).mean(axis=1) + 0.3
    off = np.log(parameters) - hidden
    return Tried(parameters, -float(off @ off))


def test_the_search_finds_the_best_parameters() -> None:
    tried = list(search(MODELS["speed-model"], near, candidates=80, seed=0))
    assert len(tried) == 80
    best = max(one.score for one in tried)
    assert best > -0.1
    assert best > 10 * max(one.score for one in tried[:10])


def test_the_same_seed_tries_the_same_candidates_and_more_of_them_only_go_on() -> None:
    few, many = (
        list(search(MODELS["social-force"], near_any, candidates=n, seed=3)) for n in (13, 24)
    )
    assert many[:13] == few
    assert list(search(MODELS["social-force"], near_any, candidates=13, seed=4)) != few


def near_any(parameters: tuple[float, ...]) -> Tried:
    return Tried(parameters, -sum(np.log(parameters) ** 2))


@pytest.mark.long
def test_the_command_writes_the_best_candidate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(social_force, "SCENES", ("plaza-v0",))  # it needs no download
    out = tmp_path / "best.json"
    main(["--policy", "speed-model", "--candidates", "2", "--out", str(out)])
    found = json.loads(out.read_text())
    table = capsys.readouterr().out.splitlines()
    assert found["score"] == pytest.approx(max(float(r.split()[0]) for r in table[1:3]), abs=1e-3)
    assert list(found["parameters"]) == sorted(MODELS["speed-model"].parameters._fields)


@pytest.mark.long
def test_candidates_are_examined_until_they_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(social_force, "SCENES", ("plaza-v0",))
    monkeypatch.setattr(social_force, "TESTS", ("rimea-1", "imo-4", "rimea-6"))
    found = Judge(MODELS["speed-model"]).score(speed_model.FOUND)
    # It walks the corridor, and passes the exit faster than IMO allows: one of two limits is kept.
    assert found.tests == pytest.approx(1 + 1 / 3)
    walked = found.walk[0] + 0.1 * (found.motion[0] + found.interaction[0]) / 2
    assert found.score == pytest.approx(walked - 2 + 1 / 3)


@pytest.mark.nightly
def test_the_parameters_found_pass_rooms_in_which_the_published_ones_jam() -> None:
    tests = ("rimea-1", "rimea-6", "rimea-12", "counterflow", "door")
    (found,) = exam("speed-model", tests=tests, workers=2)
    assert found.passed == len(tests)
    (forces,) = exam("social-force", tests=tests, workers=2)
    assert {of.id for of in forces.tests if of.passed} == {"rimea-1", "rimea-6", "counterflow"}
