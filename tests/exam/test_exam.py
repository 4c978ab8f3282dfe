"""The exam: rooms are walkable, verdicts follow the limits, and bad walkers fail."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

import crowdbench
from crowdbench.cli import main
from crowdbench.errors import ActionError, OutputError, SettingError
from crowdbench.exam import TRIALS, Certificate, exam, verdicts
from crowdbench.exam.page import written
from crowdbench.exam.results import Measured, result_of
from crowdbench.exam.rooms import Room, filled
from crowdbench.exam.trial import NOT_APPLICABLE, Limit, Run, Trial
from crowdbench.policies import Straight
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation.routes import Routes

FAST = ("rimea-1", "rimea-6", "rimea-10", "door")
ETH = load_scene("eth-v0")
BODIES = structs.replace(ETH.motion, body_radius_m=0.15)


def place() -> Scene:
    return replace(ETH, motion=BODIES)


def runs_of(trial: Trial, walk_s: float | None, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A test's run with straight walkers, of `walk_s` seconds in each room."""
    if walk_s is not None:
        walk: Callable[..., crowdbench.Trajectories] = Room.walk

        def briefly(room: Room, policy: object, seed: int) -> crowdbench.Trajectories:
            return walk(Room(room.scene, room.people, walk_s, room.line), policy, seed)

        monkeypatch.setattr(Room, "walk", briefly)
    return Run(place(), crowdbench.policy("straight", ETH), 0)


@pytest.mark.parametrize("name", TRIALS)
def test_people_of_all_rooms_stand_free_and_have_a_way(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = TRIALS[name]
    run = runs_of(trial, 0.8, monkeypatch)
    trial.run(run)
    assert run.walked
    for room, _ in run.walked:
        people = room.people
        start, goal = people.start.astype(np.float64), people.goal.astype(np.float64)
        assert room.scene.walkable(start).all()
        assert room.scene.walkable(goal).all()
        apart = np.linalg.norm(start[:, None] - start[None], axis=2)[np.triu_indices(len(start), 1)]
        assert apart.min(initial=9.0) > 2 * 0.1  # bodies of 0.15 m enter one after the other
        routes = Routes.on(room.scene)
        none = np.zeros(len(start), np.int64)
        slots = np.arange(len(start))
        _, beyond = routes.next_of(none, slots, people.start, people.goal)
        assert np.isfinite(beyond).all()


@pytest.mark.parametrize("name", TRIALS)
def test_who_never_arrives_fails(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = TRIALS[name]
    run = runs_of(trial, 0.8, monkeypatch)
    assert not result_of(trial, [trial.run(run)], random_passes=False).passed


@pytest.mark.parametrize("name", TRIALS)
def test_limits_name_measured_values(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = TRIALS[name]
    values = trial.run(runs_of(trial, 0.8, monkeypatch))
    assert set(trial.limits) <= set(values)
    assert trial.task
    assert trial.guidelines
    assert trial.source


def test_each_test_of_a_guideline_is_there_or_does_not_apply() -> None:
    named = [name for trial in TRIALS.values() for name in trial.guidelines]
    assert len(set(named)) == len(named)
    told = ", ".join([*named, *NOT_APPLICABLE]).replace("15–17", "15, 16, 17")
    for guideline, count in (("RiMEA", 16), ("IMO", 11), ("ISO 20414", 17)):
        numbers = set()
        current = ""
        for word in told.replace(",", " ,").split(" , "):
            *title, number = word.split()
            current = " ".join(title) or current
            if current == guideline:
                numbers.add(int(number))
        assert numbers >= set(range(1, count + 1)), guideline


def test_straight_walkers_with_bodies_pass_and_without_fail_at_the_door() -> None:
    (with_bodies,) = exam("straight", tests=FAST, workers=1)
    assert [of.passed for of in with_bodies.tests] == [True] * len(FAST)
    assert with_bodies.body_radius_m == 0.15
    (without,) = exam("straight", tests=["door"], body_radius_m=0.0, workers=1)
    flow = without.tests[0].measured[0]
    assert not without.tests[0].passed
    assert flow.name == "flow, 1/(m s)"
    assert flow.mean is not None
    assert flow.mean > 10


@pytest.mark.long
def test_results_are_the_same_for_any_number_of_workers() -> None:
    names = ["straight", "social-force"]
    assert exam(names, tests=FAST, workers=1) == exam(names, tests=FAST, workers=2)


def test_random_walkers_fail_and_tests_that_they_pass_are_marked() -> None:
    (certificate,) = exam("random", tests=FAST, workers=1)
    assert certificate.passed == sum(of.random_passes for of in certificate.tests) == 0


def test_a_policy_fails_a_test_in_which_it_raises_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few = {name: TRIALS[name] for name in ("rimea-1", "imo-1")}
    monkeypatch.setattr("crowdbench.exam.examine.TRIALS", few)

    def refuse(run: Run) -> dict[str, float]:
        raise ActionError("act", got="NaN", expected="a finite action")

    assert verdicts("straight", "eth-v0").passed == 2
    assert verdicts(Straight(), "eth-v0") == verdicts("straight", "eth-v0")
    few["imo-1"] = replace(few["imo-1"], run=refuse)
    found = verdicts("straight", "eth-v0")
    assert [of.passed for of in found.tests] == [True, False]


def trial_of(limits: dict[str, Limit]) -> Trial:
    return Trial("x", "X", ("RiMEA 1",), "a room", limits, "us", 2, lambda run: {})


@pytest.mark.parametrize(
    ("values", "passed"),
    [([1.0, 1.0], True), ([1.0, 0.8], True), ([1.0, 0.7], False), ([1.0, np.nan], False),
     ([1.0, np.inf], False)],
)  # fmt: skip
def test_the_mean_over_seeds_must_lie_within_the_limits(values: list[float], passed: bool) -> None:
    trial = trial_of({"share": Limit(0.9, 1.0)})
    result = result_of(trial, [{"share": v, "other": 5.0} for v in values], random_passes=False)
    assert result.passed is passed
    share, other = result.measured
    assert (share.limit, share.holds) == ("0.9 to 1", passed)
    assert (other.limit, other.holds) == (None, None)


def test_limits_and_values_as_text() -> None:
    assert str(Limit(1.0, 1.0)) == "1"
    assert str(Limit(low=-0.05)) == "-0.05 or more"
    assert str(Limit(high=3.0)) == "3 or less"

    def text(mean: float | None, low: float | None, high: float | None) -> str:
        return written(Measured(name="x", mean=mean, low=low, high=high, limit=None, holds=None))

    assert text(2.5, 2.5, 2.5) == "2.5"
    assert text(2.5, 2.0, 3.0) == "2.5 [2, 3]"
    assert text(None, None, None) == "never"
    assert text(None, 3.0, None) == "never"
    assert text(-1e-9, -1e-9, -1e-9) == "0"


@pytest.mark.parametrize("count", [1, 2, 7, 100, 720])
def test_places_fill_a_rectangle_evenly(count: int) -> None:
    places = filled((0, 0, 30, 4), count, np.random.default_rng(0))
    assert places.shape == (count, 2)
    assert (places > 0).all()
    assert (places < [30, 4]).all()
    if count >= 100:
        thirds = np.histogram(places[:, 0], 3, (0, 30))[0] / count
        assert np.abs(thirds - 1 / 3).max() < 0.07


def test_the_page_has_all_verdicts_values_and_pictures(tmp_path: Path) -> None:
    names = ["straight", "random"]
    certificates = exam(names, tests=["rimea-1", "door"], workers=1, out=tmp_path / "exam")
    page = (tmp_path / "exam" / "exam.html").read_text()
    assert page.count("data:image/png") == 4
    assert "straight passes 2 of\n2 tests; random passes 0 of\n2 tests." in page
    assert "26 to 34" in page
    assert "never" in page
    assert "RiMEA 2, 3, 13" in page
    found = json.loads((tmp_path / "exam" / "exam.json").read_text())
    assert [of["policy"] for of in found] == names
    assert found[0]["tests"][0]["measured"][0]["mean"] == pytest.approx(30.1, abs=0.2)
    assert isinstance(certificates[0], Certificate)


def test_a_folder_that_cannot_be_written_is_refused_before_anybody_walks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(Room, "walk")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="a file in place of a folder"):
        exam("straight", tests=FAST, out=tmp_path / "file")


def test_a_policy_that_is_named_twice_is_examined_once() -> None:
    (found,) = exam(["straight", "straight"], tests=["rimea-1"], workers=1)
    assert found.passed == 1


def test_the_command_prints_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["exam", "--policy", "straight", "random", "--test", "rimea-1", "imo-1"]
    assert main([*arguments, "--workers", "1"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    corridor = next(line for line in lines if line[:2] == ["Walking", "speed"])
    assert corridor[-3:] == ["passed", "time", "never"]
    assert ["passed", "2", "of", "2", "0", "of", "2"] in lines


@pytest.mark.parametrize(
    ("changed", "message"),
    [({"tests": ["rimea-99"]}, "expected one of rimea-1"),
     ({"policy": "straigth"}, "straight"),
     ({"body_radius_m": 0.5}, "0 \\(no bodies\\) to 0.19"),
     ({"policy": ["straight", "replay"]}, "walk where nobody was recorded"),
     ({"workers": 0}, "1 to 10,000")],
)  # fmt: skip
def test_wrong_settings_are_refused_before_anybody_walks(
    changed: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(Room, "walk")
    with pytest.raises(SettingError, match=message):
        exam(**({"policy": "straight", "tests": FAST} | changed))  # type: ignore[arg-type]
