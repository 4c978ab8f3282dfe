"""What a policy sees: what it needs, and an error where somebody asks for something else."""

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from conftest import need
from worlds import Person, simulate, square

import crowdbench
from crowdbench.errors import SettingError
from crowdbench.policies import Policy, Straight
from crowdbench.registry import spawn_model
from crowdbench.run.acting import Actor, settings_for
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings
from crowdbench.simulation.observations import size_of

PLAZA = load_scene("plaza-v0")


class Seeing:
    """A policy that stands still and remembers the width of what it saw."""

    name, sees = "seeing", "observation"

    def __init__(self, **needs: object) -> None:
        vars(self).update(needs)
        self.widths: set[int] = set()

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: np.ndarray) -> np.ndarray:
        self.widths.add(seen.shape[1])
        return np.zeros((len(seen), 2), np.float32)


def walked(policy: Policy, **chosen: Any) -> None:
    spawn = spawn_model("poisson-gmm", PLAZA)
    settings = Settings(max_alive=500, **chosen)
    rollout(PLAZA, spawn, policy, seed=0, horizon_s=4.0, start="empty", settings=settings)


@pytest.mark.parametrize(
    ("needs", "chosen", "width"),
    [
        ({"observation": "social-1"}, {}, size_of("social-1", 32)),
        ({"observation": "social-1", "rays": 32}, {"rays": 8}, size_of("social-1", 32)),
        ({"observation": "lidar-3"}, {"observation": "lidar-3"}, size_of("lidar-3", 32)),
        ({"observation": "lidar-1"}, {}, size_of("lidar-1", 32)),
        ({"observation": "lidar-1", "rays": 8}, {"rays": 8}, size_of("lidar-1", 8)),
        ({}, {"rays": 8}, size_of("lidar-2", 8)),
        ({"rays": 8}, {}, size_of("lidar-2", 8)),
        ({}, {"observation": "social-1"}, size_of("social-1", 32)),
        ({}, {}, size_of("lidar-2", 32)),
    ],
)
def test_with_any_capacity_a_policy_sees_what_it_needs(
    needs: dict[str, object], chosen: dict[str, object], width: int
) -> None:
    policy = Seeing(**needs)
    walked(policy, **chosen)
    assert policy.widths == {width}


CONTRADICTIONS = [
    ({"observation": "social-1"}, {"observation": "lidar-2"}),
    ({"observation": "lidar-2"}, {"observation": "social-1"}),
    ({"rays": 8}, {"rays": 16}),
    ({"observation": "lidar-2"}, {"rays": 8}),
    ({"observation": "lidar-3", "ray_range_m": 5.0}, {"ray_range_m": 10.0}),
]


@pytest.mark.parametrize(("needs", "chosen"), CONTRADICTIONS)
def test_settings_that_say_something_else_are_refused(
    needs: dict[str, object], chosen: dict[str, object]
) -> None:
    with pytest.raises(SettingError) as refused:
        walked(Seeing(**needs), **chosen)
    ((name, said),) = chosen.items()
    assert refused.value.got == f"{name} = {said!r} in the settings"
    needed = needs.get(name, 32)  # rays, if none are named
    assert refused.value.expected == f"{name} = {needed!r}, which the policy needs"
    assert f"{name}={needed!r}" in refused.value.hint


@pytest.mark.parametrize(("needs", "chosen"), [*CONTRADICTIONS, ({"rays": 8}, {})])
def test_nobody_walks_where_a_policy_sees_something_else(
    needs: dict[str, object], chosen: dict[str, Any]
) -> None:
    simulation = simulate(square(), Person(), settings=Settings(max_alive=4, **chosen))
    with pytest.raises(SettingError, match="which the policy needs"):
        Actor(Seeing(**needs), simulation)


def test_a_policy_that_sees_the_state_takes_any_settings() -> None:
    chosen = Settings(observation="social-1", rays=3)
    assert settings_for(Straight(), chosen) == chosen
    walked(Straight(), observation="social-1")


def test_a_network_names_the_observation_that_it_needs() -> None:
    need(find_spec("onnxruntime"), "onnxruntime, of the extra onnx,")
    policy = crowdbench.policy("anticipate", "eth-v0")
    policy.reset(load_scene("eth-v0"), np.random.default_rng(0))
    with pytest.raises(SettingError, match=r"observations of 38 numbers.*of social-1") as refused:
        policy.act(np.zeros((3, 38), np.float32))
    assert "observation='social-1'." in refused.value.hint


def test_a_network_walks_with_any_capacity() -> None:
    need(find_spec("onnxruntime"), "onnxruntime, of the extra onnx,")
    scene = load_scene("eth-v0")
    spawn, policy = spawn_model("poisson-gmm", scene), crowdbench.policy("anticipate", "eth-v0")
    usual, roomy = (
        rollout(scene, spawn, policy, seed=0, horizon_s=20.0, start="empty", settings=settings)
        for settings in (None, Settings(max_alive=500))
    )
    assert usual.xy.tobytes() == roomy.xy.tobytes()
    with pytest.raises(SettingError, match="social-1"):
        rollout(scene, spawn, policy, seed=0, settings=Settings(observation="lidar-2"))
