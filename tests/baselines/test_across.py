"""Walkers of several scenes: what they are trained on, and how they are kept from being scored on
it.
"""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from crowdbench import load_scene, policy, rollout, spawn_model
from crowdbench.baselines import anticipate
from crowdbench.baselines.anticipate import (
    AHEAD_S,
    Samples,
    decision_frames,
    frames_ahead,
    pooled,
)
from crowdbench.baselines.command import Command
from crowdbench.errors import SettingError
from crowdbench.evaluation import evaluate
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.registry import ANY_PLACE, import_recording
from crowdbench.scene import list_scenes
from crowdbench.simulation import social
from crowdbench.simulation.social import with_velocities_times

PLAZA, ETH, HOTEL = load_scene("plaza-v0"), load_scene("eth-v0"), load_scene("hotel-v0")
GC = load_scene("gc-v0")


def samples(first: float, number: int) -> Samples:
    return Samples(torch.full((number, 3), first), torch.zeros(number, 2))


def test_scenes_count_as_the_roots_of_their_numbers_of_samples() -> None:
    both = pooled([samples(1.0, 100), samples(2.0, 1600)])
    count = Counter(both.seen[:, 0].tolist())
    assert count == {1.0: 340, 2.0: 1360}
    assert len(both.did) == 1700


def test_of_one_scene_each_sample_is_used_once() -> None:
    one = Samples(torch.arange(10.0)[:, None], torch.zeros(10, 2))
    assert sorted(pooled([one]).seen[:, 0].tolist()) == list(range(10))


def test_samples_of_a_small_scene_are_used_about_equally_often() -> None:
    one = Samples(torch.arange(4.0)[:, None], torch.zeros(4, 2))
    assert set(Counter(one.shared(10).seen[:, 0].tolist()).values()) == {2, 3}


def test_a_network_for_several_scenes_looks_ahead_farther_than_to_the_next_decision() -> None:
    assert (frames_ahead(ETH), decision_frames(ETH)) == (1, 1)
    assert (frames_ahead(GC), decision_frames(GC)) == (2, 2)
    assert (frames_ahead(ETH, HOTEL), decision_frames(ETH, HOTEL)) == (round(AHEAD_S / ETH.dt_s), 1)


def test_a_scene_is_left_out(tmp_path: Path) -> None:
    scenes = ["eth-v0", "hotel-v0", "zara1-v0"]
    command = Command.of_several("anticipate", scenes, "hotel-v0", ["full"], tmp_path, ["--x"])
    assert [scene.id for scene in command.scenes] == ["eth-v0", "zara1-v0"]
    assert command.name == "anticipate-any"
    assert command.line == "python -m crowdbench.baselines.anticipate --x"


@pytest.mark.parametrize(
    ("scenes", "left_out", "message"),
    [
        (["eth-v0", "hotel-v0"], "gc-v0", "--leave-out: got gc-v0; expected one of the scenes"),
        (["eth-v0", "hotel-v0"], "hotel-v0", "--scenes: got 1 to train on; expected two or more"),
        (["eth-v0", "eth-v0"], None, "--scenes: got 1 to train on"),
        (["eth-v0", "plaza-v0"], None, "eth-v0 with 5 m/s, plaza-v0 with 3 m/s"),
    ],
)
def test_scenes_that_cannot_be_pooled_are_refused(
    scenes: list[str], left_out: str | None, message: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingError) as error:
        Command.of_several("anticipate", scenes, left_out, ["full"], tmp_path, [])
    assert message in str(error.value)


def test_frames_must_be_about_equally_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network that decides every k frames would decide at other times elsewhere."""
    monkeypatch.setattr(
        "crowdbench.baselines.command.load_scene",
        lambda name: replace(ETH, id="fast", dt_s=0.1) if name == "fast" else load_scene(name),
    )
    with pytest.raises(SettingError, match=r"forum-v0 with 0.444 s, fast with 0.1 s"):
        Command.of_several(
            "anticipate", ["eth-v0", "forum-v0", "fast"], None, ["full"], tmp_path, []
        )
    assert Command.of_several("anticipate", ["eth-v0", "forum-v0"], None, ["full"], tmp_path, [])


def test_a_scene_may_have_no_samples() -> None:
    """If nobody of a small recording is held out."""
    assert len(pooled([samples(1.0, 4), samples(2.0, 0)])) == 4
    assert len(pooled([samples(1.0, 0)])) == 0


def test_leave_out_needs_several_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    assert anticipate.main(["--scene", "plaza-v0", "--leave-out", "eth-v0"]) == 2
    assert "--leave-out: got --scene; expected --scenes" in capsys.readouterr().err


class Constant(nn.Module):
    """Walks straight at 1 m/s, in units of 5 m/s."""

    def forward(self, seen: Tensor) -> Tensor:
        return 0.2 * seen[:, social.ROUTE_DIRECTION]


@pytest.mark.parametrize(
    ("revision", "kept"), [("0123456789ab", True), ("0123456789ab-dirty", False), ("", False)]
)
def test_a_file_is_kept_only_if_its_code_is_known(
    revision: str, kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("crowdbench.baselines.command.revision", lambda folder: revision)
    command = Command.of("ppo", "plaza-v0", ["full"], tmp_path, ["--scene", "plaza-v0"])
    assert not command.has_written("full")
    command.write("full", Constant(), observation="social-1", noise=0)
    assert command.has_written("full") == kept
    assert not Command.of("ppo", "plaza-v0", ["full"], tmp_path, ["--seed", "1"]).has_written(
        "full"
    )


def of_both(tmp_path: Path, **more: float) -> Path:
    card = PolicyCard(
        name="of-both", observation="social-1", scene="eth-v0+plaza-v0", split="full", **more
    )
    return export_policy(Constant(), tmp_path / "net.onnx", card)


def test_speeds_are_converted_where_the_maximum_speed_differs(tmp_path: Path) -> None:
    network = OnnxPolicy(of_both(tmp_path, max_speed_mps=5.0))
    spawn = spawn_model("poisson-gmm", PLAZA)
    crowd = rollout(PLAZA, spawn, network, seed=0, horizon_s=60.0)
    steps = np.linalg.norm(np.diff(crowd.xy, axis=0), axis=1)[np.diff(crowd.row_person()) == 0]
    assert np.median(steps) / crowd.dt_s == pytest.approx(1.0, abs=1e-3)
    as_it_is = OnnxPolicy(of_both(tmp_path))
    slower = rollout(PLAZA, spawn, as_it_is, seed=0, horizon_s=60.0)
    steps = np.linalg.norm(np.diff(slower.xy, axis=0), axis=1)[np.diff(slower.row_person()) == 0]
    assert np.median(steps) / crowd.dt_s == pytest.approx(0.6, abs=1e-3)


def test_observed_speeds_are_converted() -> None:
    seen = np.random.default_rng(0).uniform(-1, 1, (4, social.SIZE)).astype(np.float32)
    before = seen.copy()
    found = with_velocities_times(0.5, seen)
    changed = np.zeros(social.SIZE, bool)
    for part in (social.VELOCITY, social.PREFERRED_SPEED):
        changed[part] = True
    changed[social.NEIGHBOURS].reshape(8, 8)[:, social.APPROACH] = True
    np.testing.assert_array_equal(found, np.where(changed, 0.5 * before, before))
    np.testing.assert_array_equal(seen, before)


def test_a_policy_of_several_scenes_is_not_scored_on_them(tmp_path: Path) -> None:
    file = of_both(tmp_path)
    with pytest.raises(SettingError, match="a network trained on full of eth-v0, plaza-v0"):
        evaluate(
            "plaza-v0",
            spawn="poisson-gmm",
            policy=str(file),
            protocol="heldout",
            out=tmp_path / "out",
        )


def test_the_policy_for_any_place_is_found_on_each_scene() -> None:
    shipped = policy(ANY_PLACE, PLAZA)
    assert isinstance(shipped, OnnxPolicy)
    assert set(shipped.card.scenes) == set(list_scenes()) - {"plaza-v0"}
    assert shipped.path.stat().st_size < 1e6


@pytest.mark.nightly
def test_it_trains_on_two_scenes_and_validates_on_the_third(
    opentraj: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("eth", "hotel", "zara01"):
        import_recording(name, opentraj)
    monkeypatch.setattr(anticipate, "GRID", {"avoid": (16.0,), "delay": (0.0, 1.0)})
    monkeypatch.setattr(anticipate, "CORRECTIONS", 1)
    monkeypatch.setattr(anticipate, "ROOM", (0.0,))
    given = ["--scenes", "eth-v0", "hotel-v0", "zara1-v0", "--leave-out", "zara1-v0"]
    more = ["--steps", "50", "--people", "1", "--out", str(tmp_path)]
    assert anticipate.main(given + more) == 0
    said = capsys.readouterr().out
    assert said.count("): walk ") == 1  # neither widths nor delays are tried
    assert said.count("eth-v0 ") == said.count("hotel-v0 ") == 2  # walk, and companions
    assert "on zara1-v0" in said
    card = OnnxPolicy(tmp_path / "full.onnx").card
    assert (card.scene, card.interval, card.max_speed_mps) == ("eth-v0+hotel-v0", 1, 5.0)
