"""Networks drive robots as files that say for which robot they are."""

from pathlib import Path

import numpy as np
import pytest
from conftest import need_sb3

from crowdbench.errors import SettingError, WeightsError
from crowdbench.policies import OnnxPolicy
from crowdbench.robot.comparison import compare
from crowdbench.robot.controllers import Controller, controller
from crowdbench.robot.network import RobotNetwork, export_robot
from crowdbench.robot.robots import DELIVERY, HOLONOMIC_ROBOT
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import load_scene

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
PLAZA = load_scene("plaza-v0")
QUICK = {"robot": "holonomic", "walkers": "straight", "time_limit_s": 8.0}


class AlongTheWay(torch.nn.Module):
    """A holonomic robot at full speed towards the next point of its path."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return seen[:, :2] * self.scale


@pytest.fixture(scope="module", params=["social", "lidar"])
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    worlds = RobotWorlds(PLAZA, 1, observation=request.param, rays=36, **QUICK)
    path = tmp_path_factory.mktemp("robots") / "along.onnx"
    return export_robot(AlongTheWay(), path, worlds, name="along", command="by hand")


def test_a_network_drives_like_the_controller_that_computes_the_same(file: Path) -> None:
    assert isinstance(controller(str(file), PLAZA), Controller)
    found = compare(PLAZA, ["straight", str(file)], episodes=3, workers=1, **QUICK)
    straight, network = (of.measures for of in found.results)
    for name in ("success", "collision", "mean_distance_m", "jerk_mps3"):
        assert network[name].value == pytest.approx(straight[name].value, rel=1e-3), name


def test_its_card_says_for_whom_it_is(file: Path) -> None:
    card = RobotNetwork(file).card
    assert (card.name, card.robot, card.kinematics) == ("along", "holonomic", "holonomic")
    assert (card.scene, card.walkers, card.command) == ("plaza-v0", "straight", "by hand")


def test_another_robot_is_refused(file: Path) -> None:
    with pytest.raises(SettingError, match="kinematics = unicycle"):
        RobotNetwork(file).reset(PLAZA, DELIVERY, 1, PLAZA.dt_s)
    with pytest.raises(SettingError, match=r"period_s = 0\.1"):
        RobotNetwork(file).reset(PLAZA, HOLONOMIC_ROBOT, 1, 0.1)


def test_people_cannot_walk_by_it_and_robots_not_by_people(file: Path, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="card"):
        OnnxPolicy(file)
    walker = PLAZA.folder.parent / "anticipate-any.onnx"
    with pytest.raises(WeightsError, match="card"):
        controller(str(walker), PLAZA)
    with pytest.raises(WeightsError):
        controller(str(tmp_path / "none.onnx"), PLAZA)


def test_a_network_that_does_not_fit_the_observation_is_refused(tmp_path: Path) -> None:
    worlds = RobotWorlds(PLAZA, 1, **QUICK)
    with pytest.raises(WeightsError, match="takes 5 numbers"):
        export_robot(torch.nn.Linear(5, 2), tmp_path / "no.onnx", worlds)
    state = RobotWorlds(PLAZA, 1, observation="state", **QUICK)
    with pytest.raises(SettingError, match="social or lidar"):
        export_robot(AlongTheWay(), tmp_path / "no.onnx", state)


@pytest.mark.nightly
def test_the_baseline_trains_exports_and_compares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    need_sb3()
    from crowdbench.baselines import robot

    quick = "--worlds 4 --steps 128 --batch-steps 16 --minibatch 32 --epochs 1 --episodes 2"
    asked = ["--scene", "plaza-v0", *quick.split(), "--out", str(tmp_path)]
    assert robot.main(asked) == 0
    assert "straight" in capsys.readouterr().out
    network = RobotNetwork(tmp_path / "full.onnx")
    assert network.card.command.startswith("python -m crowdbench.baselines.robot --scene plaza-v0")
    assert np.isfinite(network._run({"observation": np.zeros((2, 70), np.float32)})).all()
    assert robot.main(["--scene", "plaza-v0", "--std", "0", "--out", str(tmp_path)]) == 2
