"""Behaviour cloning: a proper distribution, learned from what was shown, exported as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest
from conftest import need_imitation

need_imitation()

import torch  # noqa: E402
from gymnasium import spaces  # noqa: E402
from torch import distributions  # noqa: E402

from crowdbench import Demonstrations, rollout, spawn_model  # noqa: E402
from crowdbench.baselines import bc  # noqa: E402
from crowdbench.baselines.mixture import (  # noqa: E402
    CHANGES,
    NOISE,
    Mixture,
    MixturePolicy,
    MixtureSampler,
    features_of,
    target_distance_m,
)
from crowdbench.policies import OnnxPolicy  # noqa: E402
from crowdbench.scene import load_scene  # noqa: E402
from crowdbench.simulation import social  # noqa: E402

PLAZA = load_scene("plaza-v0")


def some(components: int = 3, persons: int = 4) -> Mixture:
    torch.manual_seed(1)
    return Mixture(torch.randn(persons, 5 * components), torch.rand(persons, 2) - 0.5)


def test_its_density_is_that_of_a_mixture_of_gaussians() -> None:
    mixture = some()
    torchs = distributions.MixtureSameFamily(
        distributions.Categorical(logits=mixture.log_weight),
        distributions.Independent(distributions.Normal(mixture.mean, mixture.log_std.exp()), 1),
    )
    actions = torch.rand(4, 2) - 0.5
    torch.testing.assert_close(mixture.log_prob(actions), torchs.log_prob(actions))


def test_what_is_drawn_has_its_mean_and_its_variance() -> None:
    one = some(persons=1)
    many = Mixture.__new__(Mixture)
    many.mean = one.mean.expand(100_000, -1, -1)
    many.log_std = one.log_std.expand(100_000, -1, -1)
    many.log_weight = one.log_weight.expand(100_000, -1)
    drawn = many.drawn(torch.randn(100_000, NOISE))
    weight = one.log_weight.exp()[0, :, None]
    mean = (weight * one.mean[0]).sum(dim=0)
    second = (weight * (one.mean[0] ** 2 + (2 * one.log_std[0]).exp())).sum(dim=0)
    torch.testing.assert_close(drawn.mean(dim=0), mean, atol=0.02, rtol=0)
    torch.testing.assert_close(drawn.var(dim=0), second - mean**2, atol=0.0, rtol=0.05)


def test_noise_chooses_components_by_their_weight() -> None:
    mixture = Mixture(torch.zeros(3, 10), torch.zeros(3, 2))
    mixture.mean = torch.tensor([[[-1.0, 0.0], [1.0, 0.0]]]).expand(3, -1, -1)
    mixture.log_weight = torch.log(torch.tensor([[0.25, 0.75]])).expand(3, -1)
    # A quarter of normal numbers lies below -0.6745.
    noise = torch.tensor([[-0.70, 0.0, 0.0], [-0.65, 0.0, 0.0], [40.0, 0.0, 0.0]])
    assert mixture.drawn(noise)[:, 0].tolist() == [-1.0, 1.0, 1.0]


def test_batches_show_everything_once_in_another_order_each_time() -> None:
    x = np.arange(40, dtype=np.float32).reshape(20, 2)
    batches = bc.Batches({"obs": x, "acts": x + 100}, 5, np.random.default_rng(0))
    first, second = (np.concatenate([b["obs"].numpy() for b in batches]) for _ in range(2))
    assert sorted(first[:, 0].tolist()) == x[:, 0].tolist() == sorted(second[:, 0].tolist())
    assert first.tolist() != second.tolist()
    assert all((b["acts"] - b["obs"] == 100).all() for b in batches)


def trips(persons: int = 60, steps: int = 20) -> Demonstrations:
    """People who turn towards their goal a little in each step."""
    rng = np.random.default_rng(0)
    rows = persons * (steps + 1)
    seen = rng.uniform(-1, 1, (rows, 7)).astype(np.float32)
    acts = (0.8 * seen[:, :2] + 0.2 * seen[:, 3:5] + 0.01 * rng.normal(size=(rows, 2))).clip(-1, 1)
    acts = acts.astype(np.float32)
    acts[steps :: steps + 1] = np.nan
    return Demonstrations(
        observations=seen,
        actions=acts,
        person=np.arange(persons),
        offsets=np.arange(persons + 1) * (steps + 1),
        first=np.zeros(persons, dtype=np.int64),
        entered=np.ones(persons, dtype=bool),
        complete=np.ones(persons, dtype=bool),
    )


def test_cloning_learns_what_was_shown_and_the_same_from_the_same_seed() -> None:
    brief = bc.BcSettings(learning_rate=5e-3, batch_size=64, epochs=1)
    longer = bc.BcSettings(learning_rate=5e-3, batch_size=64, epochs=30)
    (_, little, _), (policy, much, epochs) = (bc.clone([trips()], s) for s in (brief, longer))
    assert much > little + 1.0
    assert 1 < epochs <= 30
    again, _, _ = bc.clone([trips()], longer)
    for name, values in policy.state_dict().items():
        assert torch.equal(values, again.state_dict()[name])
    seen, _ = trips().pairs()
    mode = policy.get_distribution(torch.from_numpy(seen)).mode().detach().numpy()
    expected = (0.8 * seen[:, :2] + 0.2 * seen[:, 3:5]).clip(-1, 1)
    assert np.abs(mode - expected).mean() < 0.06


def test_training_stops_when_nothing_gets_better() -> None:
    hasty = bc.BcSettings(learning_rate=0.3, batch_size=64, epochs=1000, patience=2)
    _, _, epochs = bc.clone([trips()], hasty)
    assert epochs < 200


def test_the_file_acts_as_the_policy_does(tmp_path: Path, capsys) -> None:
    asked = pages.arguments("docs/baselines.md", "python -m crowdbench.baselines.bc")
    small = ["--epochs", "2", "--batch-size", "512", "--seed", "3"]
    assert bc.main([*asked, *small, "--out", str(tmp_path)]) == 0
    assert "nats per action after" in capsys.readouterr().out
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert policy.noise == NOISE
    assert policy.card.command.startswith(
        "python -m crowdbench.baselines.bc --scene plaza-v0 --epochs 2"
    )
    crowd = rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy, seed=0, horizon_s=60.0)
    assert len(crowd) > 10


def test_the_sampler_draws_from_the_policy() -> None:
    policy = MixturePolicy(
        spaces.Box(-1.0, 1.0, (7,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32),
        lambda _: 1e-3,
    )  # fmt: skip
    seen, noise = torch.rand(5, 7) - 0.5, torch.randn(5, NOISE)
    expected = policy.get_distribution(seen).drawn(noise).clamp(-1, 1)
    torch.testing.assert_close(MixtureSampler(policy)(seen, noise), expected)
    actions, values, log_prob = policy(seen)
    assert actions.shape == (5, 2)
    again, same, entropy = policy.evaluate_actions(seen, actions)
    torch.testing.assert_close(again, values)
    torch.testing.assert_close(same, log_prob)
    assert entropy is None


def test_features_of_social_1_contain_the_change_that_follows_the_plan() -> None:
    space = spaces.Box(-1.0, 1.0, (social.SIZE,), np.float32)
    seen = torch.zeros(3, social.SIZE)
    seen[:, social.VELOCITY] = torch.tensor([0.1, 0.0])
    seen[:, social.ROUTE_DIRECTION] = torch.tensor([0.0, 1.0])
    seen[:, social.PREFERRED_SPEED] = 0.3
    seen[:2, social.STOP] = 1.0
    seen[:, social.ROUTE_LENGTH] = torch.tensor([[0.5], [5.0], [0.5]]) / social.ROUTE_RANGE_M
    found = features_of("social-1")(space)(seen)
    assert found.shape == (3, 114)
    # The first person is at a stop, the second one on the way to it, the third one at a goal.
    expected = torch.tensor([[-0.1, 0.0], [-0.1, 0.3], [-0.1, 0.3]]) * CHANGES
    torch.testing.assert_close(found[:, social.SIZE : social.SIZE + 2], expected)
    distances = target_distance_m(seen.numpy(), "social-1")
    np.testing.assert_allclose(distances, [0.5, 5.0, 0.5], rtol=1e-6)


def test_a_policy_can_be_cloned_on_what_others_do(tmp_path: Path) -> None:
    asked = "--scene plaza-v0 --observation social-1 --smoothing-s 2.4 --displaced-m 0"
    small = f"--epochs 3 --batch-size 512 --learning-rate 1e-3 --out {tmp_path}"
    assert bc.main([*asked.split(), *small.split()]) == 0
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert policy.observation == "social-1"
    crowd = rollout(PLAZA, spawn_model("cox-plans", PLAZA), policy, seed=0, horizon_s=60.0)
    assert len(crowd) > 10


def test_a_narrower_policy_does_the_same_more_steadily() -> None:
    policy = MixturePolicy(
        spaces.Box(-1.0, 1.0, (38,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32),
        lambda _: 1e-3,
    )  # fmt: skip
    seen = torch.rand(5, 38) - 0.5
    wide = policy.get_distribution(seen)
    policy.narrow(0.5)
    narrow = policy.get_distribution(seen)
    assert torch.equal(wide.mean, narrow.mean)
    assert torch.equal(wide.log_weight, narrow.log_weight)
    torch.testing.assert_close(0.5 * wide.log_std.exp(), narrow.log_std.exp())


def test_what_is_done_near_goals_can_be_shown_more_often() -> None:
    near = trips()
    near.observations[:, 2] = np.tile(np.repeat([0.01, 0.5], 21), 30)[: len(near.observations)]
    brief = bc.BcSettings(learning_rate=5e-3, batch_size=64, epochs=3)
    (_, once, _), (_, often, _) = (
        bc.clone([near], replace(brief, homing=homing)) for homing in (1, 5)
    )
    assert once != often


def test_unknown_scenes_are_said(capsys, tmp_path: Path) -> None:
    assert bc.main(["--scene", "moon-v0", "--out", str(tmp_path)]) == 2
    assert "moon-v0" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong",
    ["--width 0", "--homing 0", "--hidden 0", "--batch-size 0", "--copies 0", "--splits fold9"],
)
def test_what_cannot_be_trained_is_said(wrong: str, capsys, tmp_path: Path) -> None:
    asked = ["--scene", "plaza-v0", "--out", str(tmp_path), *wrong.split()]
    assert bc.main(asked) == 2
    assert "crowdbench.baselines.bc: " in capsys.readouterr().err
