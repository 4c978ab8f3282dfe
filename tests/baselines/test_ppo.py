"""PPO: advantages of one life at a time, and a network that is exported as it acts."""

import shutil
from pathlib import Path

import numpy as np
import pages
import pytest
import torch
from given import Given
from tensordict import TensorDict
from torch import Tensor
from worlds import Person, square

from crowdbench import Reward, load_scene, spawn_model
from crowdbench.baselines import ppo
from crowdbench.baselines.walked import walked
from crowdbench.envs.torchrl_env import CrowdEnv
from crowdbench.errors import SettingError
from crowdbench.policies import OnnxPolicy
from crowdbench.simulation import social

pytestmark = pytest.mark.long

GAMMA, LMBDA = 0.9, 0.8


def critic(seen: Tensor) -> Tensor:
    """Any function of what is seen."""
    return 3.0 * seen[..., 2:3] + seen[..., 3:4]


@pytest.fixture
def batch() -> TensorDict:
    """One slot: someone who arrives, then someone whom the horizon cuts off."""
    people = (
        Person(start=(0.0, 0.0), goal=(3.5, 0.0)),
        Person(time_s=2.0, start=(0.0, 5.0), goal=(-9.0, 5.0)),
    )
    env = CrowdEnv(square(), spawn=Given(*people), max_alive=1, rays=4, horizon_s=4.0,
                   reward=Reward(pace=-0.1))  # fmt: skip

    def policy(now: TensorDict) -> TensorDict:
        now["agents", "action"] = torch.tensor([[[0.7, 0.0]]])
        return now

    return env.rollout(10, policy, break_when_any_done=False)


def of_one_life(rewards: list[float], values: list[float], last: float) -> list[float]:
    """Eq. 16 of Schulman et al. (2016), by the book; `last` is the value after the last step."""
    after = [*values[1:], last]
    deltas = [r + GAMMA * v2 - v for r, v, v2 in zip(rewards, values, after, strict=True)]
    return [
        sum((GAMMA * LMBDA) ** k * delta for k, delta in enumerate(deltas[t:]))
        for t in range(len(deltas))
    ]


def test_an_advantage_is_of_one_life(batch: TensorDict) -> None:
    acted = batch["agents", "mask"][0, :, 0]
    person = batch["agents", "person_id"][0, :, 0]
    assert set(person[acted].tolist()) == {0, 1}
    assert not acted.all()  # between the two nobody is there
    advantage, target = ppo.advantages(batch, critic, GAMMA, LMBDA)
    after = batch["next", "agents"]
    for who in (0, 1):
        rows = (acted & (person == who)).nonzero()[:, 0].tolist()
        rewards = [after["reward"][0, t, 0, 0].item() for t in rows]
        values = [critic(batch["agents", "observation"][0, t, 0]).item() for t in rows]
        end = after["observation"][0, rows[-1], 0]
        arrived = after["terminated"][0, rows[-1], 0].item()
        assert arrived == (who == 0)
        expected = of_one_life(rewards, values, 0.0 if arrived else critic(end).item())
        got = advantage[0, rows, 0, 0].tolist()
        assert got == pytest.approx(expected, abs=1e-5)
        np.testing.assert_allclose(target[0, rows, 0, 0], np.add(expected, values), atol=1e-5)


@pytest.mark.parametrize("forgotten", ["ends", "last observation"])
def test_a_wrong_bootstrap_gives_another_number(batch: TensorDict, forgotten: str) -> None:
    right, _ = ppo.advantages(batch, critic, GAMMA, LMBDA)
    wrong = batch.clone()
    if forgotten == "ends":
        for name in ("done", "terminated"):
            wrong["next", "agents", name][:] = False
    else:  # the slot's next row instead of what the person itself saw last
        seen = wrong["next", "agents", "observation"]
        seen[:, -1] = 0.0
    other, _ = ppo.advantages(wrong, critic, GAMMA, LMBDA)
    acted = batch["agents", "mask"]
    assert not torch.allclose(right[acted], other[acted], atol=1e-3)


def test_only_steps_of_people_are_learned_from(batch: TensorDict) -> None:
    steps = ppo.steps_of(batch, *ppo.advantages(batch, critic, GAMMA, LMBDA))
    assert len(steps) == int(batch["agents", "mask"].sum())
    assert len(steps) < 10


def test_only_people_act() -> None:
    network = ppo.Around("lidar-2", 38, 16, std=0.1)
    seen, mask = torch.rand(2, 3, 38), torch.tensor([[True, False, True], [False, False, True]])
    actions = ppo.OfPresent(network)(seen, mask)
    assert (actions[~mask] == 0).all()
    assert (actions[mask] != 0).all()
    mean, _ = network(seen)
    assert (actions - mean)[mask].abs().max() < 0.6  # six standard deviations


def test_it_trains_and_its_file_acts_as_it_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = pages.arguments("docs/baselines.md", "python -m crowdbench.baselines.ppo")
    small = ["--frames", "400", "--batch-frames", "200", "--worlds", "2", "--horizon-s", "20"]
    assert ppo.main([*asked, *small, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "400 of 400 frames" in printed
    assert "agent-steps/s  0 s left" in printed
    assert "at goal" in printed
    assert "of the preferred speed" in printed
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert policy.card.command.startswith("python -m crowdbench.baselines.ppo --scene plaza-v0")
    assert policy.noise == ppo.NOISE


def test_the_untrained_network_walks_towards_the_goal() -> None:
    network = ppo.Around("lidar-2", 38, 16, std=0.1)
    seen = torch.rand(100, 38) * 0.4
    acted = ppo.GaussianSampler(network)(seen, torch.zeros(100, ppo.NOISE))
    torch.testing.assert_close(acted, seen[:, 3:5] * seen[:, 5:6])
    noise = torch.ones(100, ppo.NOISE)
    torch.testing.assert_close(ppo.GaussianSampler(network)(seen, noise), acted + 0.1)


def test_in_the_own_frame_it_stands_at_stops() -> None:
    network = ppo.Around("social-1", social.SIZE, 16, std=0.1)
    seen = torch.zeros(4, social.SIZE)
    seen[:, social.ROUTE_DIRECTION] = torch.tensor([0.6, -0.8])
    seen[:, social.PREFERRED_SPEED] = 0.25
    stop, near_m = torch.tensor([1.0, 1.0, 0.0, 0.0]), torch.tensor([0.5, 1.5, 0.5, 1.5])
    seen[:, social.STOP.start] = stop
    seen[:, social.ROUTE_LENGTH.start] = near_m / social.ROUTE_RANGE_M
    mean, _ = network(seen)
    walks = torch.tensor([0.15, -0.2])
    torch.testing.assert_close(mean, torch.stack([torch.zeros(2), walks, walks, walks]))


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
def test_training_improves_the_reward(observation: str) -> None:
    # A wide Gaussian leaves more to be learned.
    settings = ppo.PpoSettings(
        observation=observation,
        worlds=16,
        frames=48_000,
        batch_frames=1600,
        minibatch=2048,
        std=0.1,
    )
    rewards = [one.figures["reward"] for one in ppo.train("plaza-v0", settings)]
    assert np.mean(rewards[-5:]) > np.mean(rewards[:5]) + 0.03


def test_it_trains_in_a_scene_folder_with_bodies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "plaza-v0"
    shutil.copytree(load_scene("plaza-v0").folder, folder)
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace("[motion]", "[motion]\nbody_radius_m = 0.15"))
    asked = f"--scene {folder} --observation social-1-contact --spawn poisson-gmm --frames 400"
    small = ["--batch-frames", "200", "--worlds", "2", "--horizon-s", "20", "--out", str(tmp_path)]
    assert ppo.main([*asked.split(), *small]) == 0
    assert "of the preferred speed" in capsys.readouterr().out
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert (policy.card.observation, policy.card.inputs) == ("social-1-contact", social.SIZE + 2)


@pytest.mark.nightly
def test_with_plans_people_keep_their_speeds_stops_and_companions(tmp_path: Path) -> None:
    asked = "--scene eth-v0 --observation social-1 --spawn cox-plans --frames 128000"
    assert ppo.main([*asked.split(), "--out", str(tmp_path)]) == 0
    scene = load_scene("eth-v0")
    found = walked(
        scene, spawn_model("cox-plans", scene), OnnxPolicy(tmp_path / "full.onnx"), horizon_s=600.0
    )
    assert found.speed_mps == pytest.approx(found.preferred_mps, rel=0.1)
    assert found.arrived >= 0.95
    assert found.stood >= 0.8
    assert found.apart_m == pytest.approx(found.recorded_apart_m, abs=0.3)


def test_unknown_scenes_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ppo.main(["--scene", "moon-v0", "--out", str(tmp_path)]) == 2
    assert "moon-v0" in capsys.readouterr().err


def test_several_processes_act_by_the_network_as_it_is_now() -> None:
    settings = ppo.PpoSettings(
        worlds=8, frames=3200, batch_frames=800, collectors=2, learning_rate=1e-12, gamma=0.5
    )
    rounds = ppo.train("plaza-v0", settings)
    first = next(rounds)
    assert first.figures["m/s"] == pytest.approx(first.figures["m/s preferred"], rel=0.2)
    with torch.no_grad():  # everyone walks backwards as fast as possible
        first.network.layers[-1].bias[0] = -10.0
    next(rounds)  # may have been collected already
    assert next(rounds).figures["m/s"] > 1.4 * first.figures["m/s"]
    rounds.close()


@pytest.mark.parametrize(
    ("changes", "told"), [({"collectors": 3}, "divisor"), ({"device": "cuda:99"}, "device")]
)
def test_what_cannot_be_trained_with_is_said(changes: dict[str, object], told: str) -> None:
    settings = ppo.PpoSettings(worlds=8, **changes)  # type: ignore[arg-type]
    with pytest.raises(SettingError, match=told):
        next(ppo.train("plaza-v0", settings))
