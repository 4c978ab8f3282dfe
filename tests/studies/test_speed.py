"""The benchmark of speed measures what it says it measures."""

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Metric, Place, Statistics, space
from crowdbench.policies import Straight
from crowdbench.registry import spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference
from studies import judging, open_square
from studies import speed as bench
from studies.__main__ import main as studies_main

pytestmark = pytest.mark.long

NAMES = [
    "core with observations, 1 × 20",
    "core with observations, 1 × 100",
    "core with observations, 1 × 300",
    "core with observations, 64 × 50",
    "core with social-1, 1 × 100",
    "core with social-1, 64 × 50",
    "core with observations and bodies, 64 × 50",
    "PettingZoo environment, 20 agents",
    "PettingZoo environment, 100 agents",
    "PettingZoo environment, 300 agents",
    "robots, 256 × 20 people",
    "TorchRL collector, 64 × 50, random",
    "TorchRL collector, 64 × 50, MLP 32-32",
    "PPO on plaza-v0, 64 worlds, MLP 64-64",
    "poisson-gmm, sampling 10,000 frames of ETH",
    "poisson-groups, sampling 10,000 frames of ETH",
    "renewal-gmm, sampling 10,000 frames of ETH",
    "ntpp-gmm, sampling 10,000 frames of ETH",
    "cox-gmm, sampling 10,000 frames of ETH",
    "poisson-paper, sampling 10,000 frames of ETH",
    "ntpp-paper, sampling 10,000 frames of ETH",
    "ntpp-gmm, one fit to plaza-v0",  # and to eth-v0 and gc-v0, where imported
    "cox-gmm, one fit to plaza-v0",  # and to gc-v0
    "plans, one fit to plaza-v0",
    "plans adjusted to cox-gmm, one fit to plaza-v0",
    "rollout of ETH, straight",
    "rollout of ETH, social-force",
    "scoring 20 rollouts of ETH, all metrics",
    "intervals and ranks of 10 entries on ETH",
    "poisson-gmm, sampling 10,000 frames of GC",
    "ntpp-gmm, sampling 10,000 frames of GC",
    "cox-plans, sampling 10,000 frames of GC",
    "rollout of GC, straight",
    "rollout of GC, social-force",
    "rollout of GC, gail",
    "rollout of GC, anticipate",
    "scoring a rollout of GC, all metrics",
    "import crowdbench",
]


@pytest.mark.nightly
def test_each_figure_is_printed_and_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "MEASURE_S", 0.01)
    monkeypatch.setattr(bench, "CHUNK_S", 0.001)
    monkeypatch.setattr(bench, "ENTRIES", 1)
    monkeypatch.setattr(bench, "LARGE_S", 20.0)
    assert studies_main(["speed", "--json", str(tmp_path / "figures.json")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines] == NAMES
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert sorted(figures) == sorted(NAMES)
    assert [n for n, figure in figures.items() if not 0 < figure["value"] < float("inf")] == []
    units = {name: figure["unit"] for name, figure in figures.items()}
    rates = dict.fromkeys(NAMES[:14], "agent-steps/s") | {
        "robots, 256 × 20 people": "robot-steps/s"
    }
    assert units == rates | dict.fromkeys(NAMES[14:], "s")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1_234_567.0, "1.235 M agent-steps/s"), (812.0, "812 agent-steps/s")],
)
def test_rates_are_written_in_millions_where_they_are_large(value: float, text: str) -> None:
    assert bench.Figure("core", value, "agent-steps/s").text() == text


@pytest.mark.parametrize("persons", [20, 300])
def test_the_measured_crowd_stands_where_people_can_walk(persons: int) -> None:
    scene = open_square.open_square(persons)
    crowd = open_square.crowd_at_once(scene, persons, seed=0)
    assert len(crowd) == persons
    assert scene.walkable(crowd.start.astype(float)).all()


def test_nobody_leaves_while_the_core_is_measured() -> None:
    from crowdbench.simulation import Settings, Simulation

    scene = open_square.open_square(50)
    simulation = Simulation(scene, worlds=2, settings=Settings(max_alive=50))
    simulation.reset([open_square.crowd_at_once(scene, 50, w) for w in range(2)], horizon=10**9)
    for action in open_square.to_and_fro((2, 50, 2)) * 3:
        simulation.step(action)
    assert simulation.slots.alive.all()


def test_judging_tells_what_each_metric_of_a_scene_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(judging, "ROLLOUTS", 2)
    out = tmp_path / "figures.json"
    assert studies_main(["speed", "--judging", "zara1-v0", "--json", str(out)]) == 0
    figures = json.loads(out.read_text())
    printed = [line.split("  ")[0] for line in capsys.readouterr().out.splitlines()]
    assert sorted(printed) == sorted(figures)
    scene = load_scene("zara1-v0")
    metrics = [metric.name for metric in read_reference(scene).metrics]
    for what, names, unit in (
        ("summarising", [*metrics, judging.SHARED], "CPU-s per 1,000 persons"),
        ("energy score", list(scene.protocol.scored), "CPU-s per rollout"),
    ):
        found = [name for name in printed if name.startswith(f"{what}, ")]
        assert sorted(found[:-1]) == sorted(f"{what}, {name}" for name in names)
        *each, total = (figures[name]["value"] for name in found)
        assert found[-1] == f"{what}, total"
        assert total == pytest.approx(sum(each))
        assert each == sorted(each, reverse=True)
        assert min(each) > 0
        assert {figures[name]["unit"] for name in found} == {unit}


def test_shared_work_is_not_put_down_to_the_metric_that_comes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, now, seen = load_scene("zara1-v0"), [0.0], []
    monkeypatch.setattr(time, "process_time", lambda: now[0])

    class Costly(space.Occupancy):
        def __init__(self, name: str, own_s: float) -> None:
            self.name, self.own_s = name, own_s  # type: ignore[misc]

        def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
            now[0] += self.own_s
            if not any(crowd is other for other in seen):
                now[0] += 10.0
                seen.append(crowd)
            return super().summarise(crowd, blocks, place)

    metrics: tuple[Metric, ...] = (Costly("first", 1.0), Costly("second", 2.0))
    reference = replace(read_reference(scene), statistics={m.name: {} for m in metrics})
    monkeypatch.setattr(judging.Reference, "metrics", property(lambda self: metrics))
    crowd = rollout(scene, spawn_model("poisson-gmm", scene), Straight(), seed=0, horizon_s=10.0)
    took_s = judging._summarising_s([crowd, crowd], reference)
    assert took_s == {"first": 2.0, "second": 4.0, judging.SHARED: 20.0}
