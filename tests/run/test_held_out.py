"""Held-out walks: in each time block those networks walk that were not trained on it."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from crowdbench import read_own, recording_of
from crowdbench.data.blocks import FOLDS, HELD_OUT, SPLITS
from crowdbench.policies.card import PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.run.jobs import plan
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.scene import load_scene
from crowdbench.spawn.events import blocks_of

PLAZA = load_scene("plaza-v0")
CARD = PolicyCard(name="test", observation="lidar-2", rays=8, scene="plaza-v0", split="full")
SPEEDS = (0.2, 0.4, 0.6)
"""Speed of each fold's network, as a share of the maximum speed."""


class Constant(nn.Module):
    """Walks towards the target at a constant speed."""

    def __init__(self, speed: float, memory: int = 0) -> None:
        super().__init__()
        self.speed, self.memory = speed, memory

    def forward(self, seen: Tensor, state: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        way = seen[:, 3:5]
        action = self.speed * way / (1e-6 + torch.linalg.norm(way, dim=1, keepdim=True))
        return action if state is None else (action, state + 1)


def networks(folder: Path, *, memory: int = 0) -> str:
    for fold, speed in enumerate(SPEEDS):
        card = msgspec.structs.replace(CARD, split=SPLITS[1 + fold], memory=memory)
        export_policy(Constant(speed, memory), folder / f"fold{fold}.onnx", card)
    return str(folder)


def test_networks_take_turns_at_the_boundaries_of_blocks(tmp_path: Path) -> None:
    policy = networks(tmp_path / "mine")
    jobs = plan(PLAZA.id, PLAZA, [("replay", policy)], "heldout", 10, tmp_path)
    assert [job.split for job in jobs] == [HELD_OUT]  # without noise, one rollout says all
    roll_out(jobs, None, 1)
    crowd = read_own(jobs[0].path)
    blocks = blocks_of(recording_of(PLAZA), PLAZA)
    step_mps = np.linalg.norm(np.diff(crowd.xy, axis=0), axis=1) / PLAZA.dt_s
    same = np.diff(crowd.row_person()) == 0
    frame = crowd.row_frame()[:-1]
    for block, (start, stop) in enumerate(blocks.frames.tolist()):
        inside = same & (frame >= start) & (frame < stop)
        expected = SPEEDS[block % FOLDS] * PLAZA.motion.max_speed_mps
        # Who is near the target, or hindered by others and walls, is slower.
        assert np.median(step_mps[inside]) == pytest.approx(expected, rel=0.02)


def test_networks_with_a_memory_walk_once_for_each_fold(tmp_path: Path) -> None:
    policy = networks(tmp_path / "mine", memory=1)
    jobs = plan(PLAZA.id, PLAZA, [("replay", policy)], "heldout", 10, tmp_path)
    assert [job.split for job in jobs] == list(SPLITS[1:])


def test_in_other_crowds_each_fold_has_its_own_fits_and_network(tmp_path: Path) -> None:
    policy = networks(tmp_path / "mine")
    jobs = plan(PLAZA.id, PLAZA, [("poisson-gmm", policy)], "heldout", 10, tmp_path)
    assert [job.split for job in jobs] == [split for split in SPLITS[1:] for _ in range(10)]


def test_all_networks_count_for_the_fingerprint(tmp_path: Path) -> None:
    policy = networks(tmp_path / "mine")
    asked = PLAZA.id, PLAZA, [("replay", policy)], "heldout", 10, tmp_path
    (before,) = plan(*asked)
    export_policy(
        Constant(0.7),
        tmp_path / "mine" / "fold2.onnx",
        msgspec.structs.replace(CARD, split="fold2"),
    )
    (after,) = plan(*asked)
    assert before.fingerprint != after.fingerprint
