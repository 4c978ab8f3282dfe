"""Rollouts that are made at once: the crowds that single rollouts make, only faster."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest
from given import Given
from worlds import Person, events, with_bodies

from crowdbench import registry
from crowdbench.data.table import Trajectories
from crowdbench.policies import Policy, Random, SocialForce, SpeedModel, StateView, Straight
from crowdbench.policies.memory import Memory
from crowdbench.policies.social_force import GroupForce
from crowdbench.run.episode import most_at_once
from crowdbench.run.jobs import BATCH, Job, batches, plan
from crowdbench.run.rollout import batchable, rollout, rollouts
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import SpawnModel

ETH = load_scene("eth-v0")
SEEDS = (4, 0, 9)


def spawn_models(count: int) -> list[SpawnModel]:
    """Different fits, as in evaluations."""
    return [registry.spawn_model("cox-plans", ETH, fit=k) for k in range(count)]


def same(one: Trajectories, other: Trajectories) -> bool:
    names = [f.name for f in fields(Trajectories)]
    values = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(np.array_equal(a, b) for a, b in values)


@pytest.mark.parametrize(
    "policy", [Straight(), SocialForce(), SpeedModel(), Random()], ids=lambda p: p.name
)
def test_crowds_of_built_in_policies_are_those_of_single_rollouts(policy: Policy) -> None:
    models = spawn_models(len(SEEDS))
    several = rollouts(ETH, models, policy, seeds=SEEDS)
    assert [crowd.provenance["seed"] for crowd in several] == list(SEEDS)
    for model, seed, crowd in zip(models, SEEDS, several, strict=True):
        assert same(crowd, rollout(ETH, model, policy, seed=seed))


@pytest.mark.long
def test_crowds_of_a_network_with_noise_are_those_of_single_rollouts_but_for_rounding() -> None:
    network, models = registry.policy("anticipate", ETH), spawn_models(len(SEEDS))
    assert batchable(network)
    assert network.noise  # type: ignore[union-attr]
    several = rollouts(ETH, models, network, seeds=SEEDS)
    for crowd, again in zip(several, rollouts(ETH, models, network, seeds=SEEDS), strict=True):
        assert same(crowd, again)
    for model, seed, crowd in zip(models, SEEDS, several, strict=True):
        alone = rollout(ETH, model, network, seed=seed)
        early = crowd.row_frame() < 20  # later, rounding may have changed a choice
        assert crowd.person_id[crowd.row_person()[early]].tolist() == (
            alone.person_id[alone.row_person()[alone.row_frame() < 20]].tolist()
        )
        np.testing.assert_allclose(crowd.xy[early], alone.xy[alone.row_frame() < 20], atol=1e-3)


def test_a_subclass_is_not_called_for_several_worlds() -> None:
    class Own(Straight):
        pass

    assert batchable(Straight())
    assert not batchable(Own())
    assert not batchable(GroupForce())


@dataclass
class Standing:
    """Nobody moves, so that all trips end by the timeout; counts the people of each call."""

    name = "standing"
    sees = "state"
    most = 0

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: StateView) -> np.ndarray:
        self.most = max(self.most, len(seen.slot))
        return np.zeros((len(seen.slot), 2), np.float32)


@pytest.mark.parametrize("wait_s", [0.0, 400.0])
def test_there_are_slots_for_everyone_even_if_nobody_reaches_a_goal(wait_s: float) -> None:
    place, every_s = with_bodies(ETH, 0.0), 5.0  # all stand in one place
    stop = {"via": (0.0, 0.0), "wait_s": wait_s} if wait_s else {}
    people = [
        Person(time_s=k * every_s, start=(3.0, 5.0), goal=(11.0, 5.0), **stop)  # type: ignore[arg-type]
        for k in range(120)
    ]
    standing = Standing()
    crowd = rollout(
        place,
        Given(*people),
        standing,
        seed=0,
        start="empty",
        horizon_s=120 * every_s,  # type: ignore[arg-type]
    )
    assert len(crowd) == 120
    expected = min(120, (place.timeout_s + wait_s) / every_s)
    assert standing.most == pytest.approx(expected, abs=6)
    slots = most_at_once(events(*people), place)
    assert standing.most <= slots <= standing.most + 12


class Noisy:
    """Walks at random, with noise that the rollout draws."""

    name = "noisy"
    sees = "observation"
    many_worlds = True
    noise = 2

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        assert memory.noise.shape == (len(seen), 2)
        return 0.1 * memory.noise


@pytest.mark.long
def test_noise_is_drawn_for_each_world_by_its_own_seed() -> None:
    models = spawn_models(3)
    several = rollouts(ETH, models, Noisy(), seeds=SEEDS)  # type: ignore[arg-type]
    others = rollouts(ETH, [*models[:2], models[0]], Noisy(), seeds=(*SEEDS[:2], 5))  # type: ignore[arg-type]
    alone = rollout(ETH, models[0], Noisy(), seed=SEEDS[0])  # type: ignore[arg-type]
    assert same(several[0], others[0])
    assert same(several[0], alone)
    assert same(several[1], others[1])
    assert not same(several[2], others[2])


def jobs_of(policy: str, seeds: int, folder: Path) -> list[Job]:
    return plan("eth-v0", ETH, [("poisson-gmm", policy)], "full", seeds, folder)


def made(jobs: Sequence[Job]) -> dict[str, tuple[int, bytes]]:
    """When the files were written, and what they contain."""
    roll_out(list(jobs), None, 1)
    return {j.path.name: (j.path.stat().st_mtime_ns, j.path.read_bytes()) for j in jobs}


@pytest.mark.long
def test_a_network_that_misses_one_rollout_makes_its_whole_batch_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_STORE", "read")  # which has nothing
    jobs = jobs_of("anticipate", 3, tmp_path)
    first = made(jobs)
    jobs[1].path.unlink()
    second = made(jobs)
    assert {name: data for name, (_, data) in first.items()} == (
        {name: data for name, (_, data) in second.items()}
    )
    assert all(second[name][0] > first[name][0] for name in first)
    assert made(jobs) == second  # nothing is missing


def test_walkers_that_are_exact_make_only_the_rollout_that_is_missing(tmp_path: Path) -> None:
    jobs = jobs_of("straight", 3, tmp_path)
    first = made(jobs)
    jobs[1].path.unlink()
    second = made(jobs)
    changed = [name for name in first if second[name][0] != first[name][0]]
    assert changed == [jobs[1].path.name]


def test_batches_are_part_of_the_fingerprint_of_networks(tmp_path: Path) -> None:
    few, many = (jobs_of("anticipate", seeds, tmp_path) for seeds in (5, BATCH + 5))
    assert [len(batch) for batch in batches(many)] == [BATCH, 5]
    assert few[0].fingerprint != many[0].fingerprint
    assert few[0].fingerprint == many[-1].fingerprint  # both are in a batch of five
    few, many = (jobs_of("straight", seeds, tmp_path) for seeds in (5, BATCH + 5))
    assert few[0].fingerprint == many[0].fingerprint
