"""GAIL: who walks so that a discriminator is at a loss, with a reward that pays nobody for time."""

import csv
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest
from conftest import need_imitation

need_imitation()

import torch  # noqa: E402
from gymnasium import spaces  # noqa: E402
from imitation.data.types import Transitions  # noqa: E402

from crowdbench import demonstrations, rollout, spawn_model  # noqa: E402
from crowdbench.baselines import bc, gail  # noqa: E402
from crowdbench.baselines.command import Command  # noqa: E402
from crowdbench.baselines.mixture import NOISE, MixturePolicy  # noqa: E402
from crowdbench.policies import OnnxPolicy  # noqa: E402
from crowdbench.scene import load_scene  # noqa: E402

PLAZA = load_scene("plaza-v0")
TINY = gail.GailSettings(
    persons=8, steps=512, round_steps=32, horizon_s=60.0, discriminator_batch=64
)


def fresh(hidden: int = 16) -> MixturePolicy:
    torch.manual_seed(0)
    return MixturePolicy(
        spaces.Box(-1.0, 1.0, (42,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32),
        lambda _: 1e-3, net_arch=[hidden, hidden],
    )  # fmt: skip


def test_experts_are_the_recorded_transitions() -> None:
    shown = demonstrations("plaza-v0")
    batch = next(iter(gail.experts(shown, 256, np.random.default_rng(0))))
    assert set(batch) >= {"obs", "acts", "next_obs", "dones"} - {"infos"}
    assert {f for f in Transitions.__dataclass_fields__ if f != "infos"} == set(batch)
    # Where the action leads: the velocity that the next observation begins with, walls excepted.
    led = (batch["next_obs"][:, :2] - batch["acts"]).abs().max(dim=1).values
    assert (led < 1e-3).float().mean() > 0.95
    trips = sum(1 for _ in shown.person)
    everything = gail.experts(shown, len(shown.pairs()[1]), np.random.default_rng(0))
    (whole,) = list(everything)
    assert int(whole["dones"].sum()) == trips


def test_the_reward_is_the_discriminators_log_odds() -> None:
    seen, act = torch.rand(5, 38) - 0.5, torch.rand(5, 2) - 0.5
    space = spaces.Box(-1.0, 1.0, (38,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32)
    net = gail.Discriminator(*space, 8, bounds=None)
    logits = net(seen, act, seen, torch.zeros(5))
    d = torch.sigmoid(logits)
    torch.testing.assert_close(logits, torch.log(d) - torch.log(1 - d))
    for parameter in net.parameters():
        parameter.data.zero_()
    assert not net(seen, act, seen, torch.zeros(5)).any()  # at a loss: no reward for time
    assert gail.FairGAIL.reward_train.fget is not gail.GAIL.reward_train.fget


def test_who_walks_out_of_bounds_that_it_sees_was_not_recorded() -> None:
    space = spaces.Box(-1.0, 1.0, (42,), np.float32), spaces.Box(-1.0, 1.0, (2,), np.float32)
    net = gail.Discriminator(*space, 8, bounds=gail.OUTSIDE["lidar-3"])
    seen, act, over = torch.rand(3, 42), torch.rand(3, 2), torch.zeros(3)
    after = torch.rand(3, 42) + 0.01
    inside = net(seen, act, after, over)
    after[1, 8] = 0.0  # beyond the southern bound
    after[2, 20] = 0.0  # at a wall
    odds = net(seen, act, after, over) - inside
    torch.testing.assert_close(odds, torch.tensor([0.0, -gail.AGAINST, 0.0]))


def test_training_changes_the_policy_and_the_same_seed_changes_it_alike() -> None:
    first, again, other = fresh(), fresh(), fresh()
    rows = [list(gail.train("plaza-v0", "full", p, TINY, seed)) for p, seed in
            ((first, 1), (again, 1), (other, 2))]  # fmt: skip
    assert rows[0] == rows[1]
    assert [row["steps"] for row in rows[0]] == [256, 512]
    untouched = fresh().state_dict()
    a, b, c = (p.state_dict() for p in (first, again, other))
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert any(not torch.equal(a[name], c[name]) for name in a)
    assert any(not torch.equal(a[name], untouched[name]) for name in a)


def test_a_discriminator_tells_wanderers_from_recorded_people() -> None:
    settings = gail.GailSettings(
        persons=16, steps=4096, round_steps=32, horizon_s=60.0, discriminator_batch=256,
        discriminator_rate=3e-3, learning_rate=0.0,
    )  # fmt: skip
    *_, last = gail.train("plaza-v0", "full", fresh(), settings, 0)
    assert last["recorded told"] > 0.9
    assert last["walked told"] > 0.8


def test_reminders_make_what_recorded_people_did_likelier() -> None:
    lots, first = [demonstrations("plaza-v0", observation="lidar-3")], bc.BcSettings(batch_size=256)
    settings = replace(TINY, steps=256, learning_rate=1e-3)
    told = next(iter(bc.everything(lots, first)))
    likely = {}
    for reminders in (0, 20):
        policy, lessons = fresh(), itertools.cycle(bc.everything(lots, first))
        asked = replace(settings, reminders=reminders)
        assert len([*gail.train("plaza-v0", "full", policy, asked, 0, lessons)]) == 1
        with torch.no_grad():
            likely[reminders] = policy.get_distribution(told["obs"]).log_prob(told["acts"]).mean()
    assert likely[20] > likely[0] + 0.1


def test_who_is_reminded_is_made_steadier_in_the_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = "--scene plaza-v0 --steps 512 --persons 8 --cloning-epochs 0 --cloning-width 0.5"
    written = []
    monkeypatch.setattr(
        Command, "write", lambda _, split, sampler, **__: written.append(sampler) or tmp_path
    )
    monkeypatch.setattr(Command, "walk", lambda *_: None)  # there is no file to walk
    monkeypatch.setattr(gail, "_write", lambda *_: None)
    for reminders in (0, 1):
        more = f"--learning-rate 0 --reminders {reminders} --out {tmp_path}"
        assert gail.main(f"{asked} {more}".split()) == 0
    before, after = (sampler.head.bias.detach() for sampler in written)
    torch.testing.assert_close(before, after)  # once, be it before or after


def test_a_discriminator_compares_with_the_paths_that_were_cloned(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    windows = []
    for module in (bc, gail):
        original = module.demonstrations
        monkeypatch.setattr(
            module,
            "demonstrations",
            lambda *a, make=original, **k: windows.append(k["smoothing_s"]) or make(*a, **k),
        )
    monkeypatch.setattr(Command, "walk", lambda *_: None)
    asked = "--scene plaza-v0 --steps 512 --persons 8 --cloning-epochs 0 --cloning-smoothing-s 1.2"
    assert gail.main([*asked.split(), "--out", str(tmp_path)]) == 0
    assert windows == [1.2, 1.2]


def test_the_file_and_the_curves_are_written(tmp_path: Path, capsys) -> None:
    asked = pages.arguments("docs/baselines.md", "python -m crowdbench.baselines.gail")
    small = "--steps 2048 --persons 16 --horizon-s 60 --cloning-epochs 1 --cloning-batch-size 512"
    assert gail.main([*asked, *small.split(), "--out", str(tmp_path)]) == 0
    assert "steps  at goal" in capsys.readouterr().out
    policy = OnnxPolicy(tmp_path / "full.onnx")
    assert policy.noise == NOISE
    assert policy.card.name == "gail"
    assert policy.card.command.startswith("python -m crowdbench.baselines.gail --scene plaza-v0")
    with (tmp_path / "full.csv").open() as file:
        curves = list(csv.DictReader(file))
    assert [int(row["steps"]) for row in curves] == [1024, 2048]
    crowd = rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy, seed=0, horizon_s=60.0)
    assert len(crowd) > 10


def test_it_can_begin_with_nothing() -> None:
    settings = bc.BcSettings(hidden=(8, 8), epochs=0)
    policy, _, epochs = bc.clone([demonstrations("plaza-v0")], settings)
    assert epochs == 0
    assert [layer.out_features for layer in gail._hidden(policy)] == [8, 8]


def test_unknown_scenes_are_said(capsys, tmp_path: Path) -> None:
    assert gail.main(["--scene", "moon-v0", "--out", str(tmp_path)]) == 2
    assert "moon-v0" in capsys.readouterr().err


def test_wrong_numbers_of_the_cloning_are_called_by_their_option(capsys, tmp_path: Path) -> None:
    asked = ["--scene", "plaza-v0", "--out", str(tmp_path)]
    assert gail.main([*asked, "--cloning-smoothing-s", "-1"]) == 2
    assert "gail: cloning-smoothing-s: got -1; expected a number, 0" in capsys.readouterr().err
    assert gail.main([*asked, "--seed", "-1"]) == 2
    assert "gail: seed: got -1" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong",
    ["--steps 0", "--persons 0", "--spawn nobody", "--cloning-width 0", "--splits fold9"],
)
def test_what_cannot_be_trained_is_said(wrong: str, capsys, tmp_path: Path) -> None:
    asked = ["--scene", "plaza-v0", "--out", str(tmp_path), *wrong.split()]
    assert gail.main(asked) == 2
    assert "crowdbench.baselines.gail: " in capsys.readouterr().err
