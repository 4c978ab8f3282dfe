"""The paper's behaviour cloning: its observation, its Gaussian, and a file that does the same."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import need_imitation

need_imitation()

import torch  # noqa: E402

from crowdbench import Demonstrations, rollout, spawn_model  # noqa: E402
from crowdbench.baselines import bc_paper  # noqa: E402
from crowdbench.baselines.bc_paper import NOISE, BcPaperSettings, PaperObservation, clone  # noqa: E402
from crowdbench.policies import OnnxPolicy  # noqa: E402
from crowdbench.scene import load_scene  # noqa: E402

PLAZA = load_scene("plaza-v0")
STEPS, SPREAD = 20, 0.02


def trips(persons: int = 60) -> Demonstrations:
    """People who walk in the direction of their goals, with noise of a known width."""
    rng = np.random.default_rng(0)
    rows = persons * (STEPS + 1)
    seen = rng.uniform(-1, 1, (rows, 37)).astype(np.float32)
    angle = rng.uniform(-3.1, 3.1, rows)
    seen[:, 3:5] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    acts = (0.2 * seen[:, 3:5] + SPREAD * rng.normal(size=(rows, 2))).astype(np.float32)
    acts[STEPS :: STEPS + 1] = np.nan
    return Demonstrations(
        observations=seen,
        actions=acts,
        person=np.arange(persons),
        offsets=np.arange(persons + 1) * (STEPS + 1),
        first=np.zeros(persons, dtype=np.int64),
        entered=np.ones(persons, dtype=bool),
        complete=np.ones(persons, dtype=bool),
    )


@pytest.mark.parametrize(
    ("direction", "turn"),
    [((1, 0), 0), ((0, 1), 0.25), ((-1, 0), 0.5), ((0, -1), -0.25), ((0.6, 0.8), 0.14758)],
)
def test_the_direction_to_the_goal_is_an_angle_over_two_pi(direction, turn: float) -> None:
    seen = torch.rand(3, 37)
    seen[:, 3:5] = torch.tensor(direction, dtype=torch.float32)
    found = PaperObservation()(seen)
    assert found.shape == (3, 36)
    torch.testing.assert_close(found[:, 3], torch.full((3,), float(turn)), atol=1e-5, rtol=0)
    torch.testing.assert_close(found[:, :3], seen[:, :3])
    torch.testing.assert_close(found[:, 4:], seen[:, 5:])


def test_cloning_learns_what_was_shown_and_the_same_from_the_same_seed() -> None:
    brief = BcPaperSettings(learning_rate=5e-3, batch_size=128, epochs=1)
    longer = replace(brief, epochs=50)
    sampler, again = clone(trips(), longer), clone(trips(), longer)
    for name, values in sampler.state_dict().items():
        assert torch.equal(values, again.state_dict()[name])
    seen, _ = trips().pairs()
    expected = 0.2 * seen[:, 3:5]

    def misses(network: bc_paper.PaperSampler) -> float:
        with torch.no_grad():
            mean = network(torch.from_numpy(seen), torch.zeros(len(seen), NOISE))
        return float(np.abs(mean.numpy() - expected).mean())

    assert misses(sampler) < 0.03 < misses(clone(trips(), brief))
    deviation = sampler.std * sampler.reach
    assert all(SPREAD < s < 2.5 * SPREAD for s in deviation.tolist())


def test_actions_are_drawn_from_the_gaussian_within_the_recorded_range() -> None:
    sampler = clone(trips(), BcPaperSettings(epochs=1))
    seen, _ = trips().pairs()
    _, did = trips().pairs()
    one = torch.from_numpy(seen[:1]).expand(50_000, -1)
    torch.manual_seed(0)
    with torch.no_grad():
        drawn = sampler(one, torch.randn(50_000, NOISE))
        still = sampler(one[:1], torch.zeros(1, NOISE))
        moved = sampler(one[:1], torch.full((1, NOISE), 0.1))
    assert (drawn.amin(dim=0) >= torch.from_numpy(did.min(axis=0)) - 1e-6).all()
    assert (drawn.amax(dim=0) <= torch.from_numpy(did.max(axis=0)) + 1e-6).all()
    torch.testing.assert_close(moved - still, (0.1 * sampler.std * sampler.reach)[None])
    # Before training the standard deviation is 1, half the range of the actions.
    assert sampler.std.tolist() == pytest.approx([1.0, 1.0], abs=0.01)
    assert math.isclose(drawn[:, 0].max(), did[:, 0].max(), abs_tol=1e-6)


def test_the_file_walks_a_crowd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["--scene", "plaza-v0", "--epochs", "2", "--seed", "3", "--out", str(tmp_path)]
    assert bc_paper.main(asked) == 0
    assert "standard deviations" in capsys.readouterr().out
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert (policy.noise, policy.observation) == (NOISE, "lidar-1")
    assert policy.card.name == "bc-paper"
    assert policy.card.command.startswith(
        "python -m crowdbench.baselines.bc_paper --scene plaza-v0"
    )
    crowd = rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy, seed=0, horizon_s=60.0)
    assert len(crowd) > 10


@pytest.mark.parametrize("wrong", [["--epochs", "0"], ["--splits", "fold7"]])
def test_bad_settings_are_refused(wrong, tmp_path: Path, capsys) -> None:
    assert bc_paper.main(["--scene", "plaza-v0", "--out", str(tmp_path / "x"), *wrong]) == 2
    assert "crowdbench.baselines.bc_paper: " in capsys.readouterr().err
