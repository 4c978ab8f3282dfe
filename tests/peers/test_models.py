"""The models of other simulators, in their own environment: `make .venv-peers/peers.stamp`."""

import contextlib
import json
import logging
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pages
import pytest
import shapely

if find_spec("jupedsim") is None:
    pytest.skip(
        "the models of other simulators have an environment of their own", allow_module_level=True
    )

from worlds import Person, box, events, simulate, square

import crowdbench
from crowdbench.cli import main
from crowdbench.cli.running import run
from crowdbench.errors import SettingError
from crowdbench.registry import policy as named
from crowdbench.registry import spawn_model
from crowdbench.run.acting import Actor
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from examples.peers import calibrated
from examples.peers.__main__ import app
from examples.peers.calibrate import search, value_of
from examples.peers.models import MODELS, Peer
from examples.peers.pysocialforce_crowd import PySocialForceCrowd

ROOT = Path(__file__).parents[2]
PLAZA = load_scene("plaza-v0")
SHORT_S = 60.0


def walked(model: Peer, seed: int = 0) -> crowdbench.Trajectories:
    return rollout(PLAZA, spawn_model("replay", PLAZA), model, seed=seed, horizon_s=SHORT_S)


@pytest.mark.parametrize("model", MODELS)
def test_everyone_is_accounted_for_and_the_same_seed_gives_the_same_crowd(model: str) -> None:
    kind = MODELS[model]
    peers = kind(), kind({name: of.published for name, of in kind.searched.items()})
    crowds = [walked(peer) for peer in peers]
    for peer, crowd in zip(peers, crowds, strict=True):
        counts = peer.counts
        assert counts["entered"] + counts["moved"] + counts["refused"] == len(crowd)
        assert counts["refused"] < 0.1 * len(crowd)
    # The published values that calibration starts from are the defaults of the library.
    np.testing.assert_array_equal(crowds[0].xy, crowds[1].xy)


@pytest.mark.parametrize("model", MODELS)
def test_other_parameters_move_people_otherwise(model: str) -> None:
    kind = MODELS[model]
    for name, of in kind.searched.items():
        assert of.low <= of.published <= of.high, name
    plain = walked(kind())
    for side in ("low", "high"):
        other = kind({name: getattr(of, side) for name, of in kind.searched.items()})
        crowd = walked(other)
        assert other.counts["refused"] < 0.1 * len(crowd)  # the simulator takes these values
        assert crowd.xy.shape != plain.xy.shape or not np.array_equal(crowd.xy, plain.xy)


@pytest.mark.parametrize("model", MODELS)
def test_people_go_round_walls_stop_at_via_points_and_arrive(model: str) -> None:
    room = square(8.0, box(-0.5, -8.0, 0.5, 2.0))
    people = (
        Person(start=(-5, -4), goal=(5, -4), speed=1.3, velocity=(1.0, 0.0)),
        Person(start=(-6, 5), goal=(6, 5.5), speed=1.2, via=(3, 5.2), wait_s=6.0),
    )

    class Arrivals:
        name, start = "two", "recorded"

        def sample(self, horizon_s, scene, rng):
            return events(*people)

    crowd = rollout(room, Arrivals(), MODELS[model](), seed=0, horizon_s=60.0)
    outcome = [crowdbench.data.table.OUTCOMES[k] for k in crowd.outcome.tolist()]
    assert outcome == ["goal", "goal"]
    assert not room.obstacles.intersects(shapely.LineString(crowd.path(0)))
    speed = np.hypot(*np.diff(crowd.path(1), axis=0).T) / room.dt_s
    # A visit begins 1 m before the point, and forces slow down gently.
    assert 2.0 <= (speed < 0.15).sum() * room.dt_s <= 9.0


@pytest.mark.parametrize("model", [name for name in MODELS if name != "pysocialforce"])
def test_who_is_put_back_goes_on_at_once(model: str) -> None:
    """JuPedSim keeps people who are taken out until its next step; they would block themselves."""
    room, peer = square(8.0), MODELS[model]()
    simulation = simulate(room, Person(start=(-5, 0), goal=(5, 0), speed=1.2, velocity=(1.2, 0.0)))
    actor = Actor(peer, simulation)
    actor.reset(np.random.default_rng(0))
    steps = []
    for frame in range(6):
        if frame == 3:
            simulation.slots.position[0, 0] += (0.0, 0.05)
        before = simulation.slots.position[0, 0, 0]
        actor.step()
        steps.append(simulation.slots.position[0, 0, 0] - before)
    assert peer.counts["put back"] == 1
    assert peer.counts["stood"] == 0
    assert min(steps) > 0.25 * max(steps)


def test_people_at_the_same_place_do_not_vanish() -> None:
    room = square(8.0)
    crowd = PySocialForceCrowd(room, {})
    person = Person(start=(0, 0), goal=(6, 0), speed=1.2, group=0)

    class Arrivals:
        name, start = "two", "recorded"

        def sample(self, horizon_s, scene, rng):
            return events(person, person)

    peer = MODELS["pysocialforce"]()
    found = rollout(room, Arrivals(), peer, seed=0, horizon_s=20.0)
    assert peer.counts["escaped"] == 0
    assert np.isfinite(found.xy).all()
    with pytest.raises(ValueError, match="unpack"):
        crowd._set("no_force.factor", 1.0)


def test_importing_pysocialforce_changes_nothing_else(tmp_path: Path) -> None:
    assert logging.getLogger().level != logging.DEBUG
    assert not (Path() / "file.log").exists()


def test_the_models_are_policies_by_name() -> None:
    walker = named("examples.peers.models:WarpDriver", "plaza-v0")
    assert walker.name == "warp-driver"


def test_who_is_not_calibrated_for_a_scene_says_so(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(calibrated, "FILE", tmp_path / "calibrated.json")
    with pytest.raises(SettingError, match=r"no calibrated parameters.*calibrate plaza-v0"):
        named("examples.peers.calibrated:WarpDriver", "plaza-v0", "fold0")
    known = {"parameters": {"warp-driver": {"plaza-v0": {"fold0": {"sigma": 0.5}}}}}
    (tmp_path / "calibrated.json").write_text(json.dumps(known))
    assert named("examples.peers.calibrated:WarpDriver", "plaza-v0", "fold0").parameters == {
        "sigma": 0.5
    }


def test_calibration_starts_from_the_published_parameters_and_continues(tmp_path: Path) -> None:
    model = "collision-free-speed-v2"
    value, first, _ = search(model, "plaza-v0", "fold0", tmp_path, 2)
    assert value >= first
    again = search(model, "plaza-v0", "fold0", tmp_path, 3)
    assert again[0] >= value
    assert again[1] == first
    assert search(model, "plaza-v0", "fold0", tmp_path, 3) == again


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (["calibrate", "nowhere"], "expected one of eth-v0"),
        (["entries", "plaza-v0", "--model", "warpdriver"], "Did you mean `warp-driver`"),
        (["exam", "--workers", "0"], "expected 1 to 10,000"),
    ],
)
def test_wrong_words_are_answered_before_hours_of_work(
    asked: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(app, asked) == 2
    assert told in capsys.readouterr().err


def test_what_exceeds_the_gate_costs() -> None:
    from crowdbench.run.validation import Validation

    def of(speed_mps: float, at_goal: float) -> float:
        none: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
        families = {"motion": 0.5, "interaction": 0.7}
        return value_of(Validation({}, families, speed_mps, 1.0, at_goal, {}, none, True), PLAZA)

    assert of(1.0, 1.0) == 0.5
    assert of(0.65, 1.0) == pytest.approx(0.5 - (0.35 - PLAZA.gate.speed))
    assert of(1.0, 0.75) == pytest.approx(0.5 - (PLAZA.gate.arrivals - 0.75))


def test_the_page_scores_your_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/your-simulator.md").read_text()
    arrivals, score = pages.commands(page)
    assert main(arrivals.split()[1:]) == 0
    (code,) = pages.blocks(page, "python")
    with contextlib.suppress(SystemExit):
        exec(compile(code, "your-simulator.md", "exec"), {})
    assert "people, " in capsys.readouterr().out
    assert main(score.split()[1:]) == 0
    assert "replay × trajectories" in capsys.readouterr().out
