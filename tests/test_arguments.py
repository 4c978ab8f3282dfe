"""Arguments of wrong types, everywhere in the Python interface: an error of ours, or it works."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import crowdbench
from crowdbench import CrowdbenchError
from crowdbench.data.table import Trajectories
from crowdbench.errors import ActionError, SettingError, check_seed, checked
from crowdbench.metrics import METRICS

HOSTILE = [
    None, 3, -1, 2.5, float("nan"), 1e300, True, "nope", "", b"x", [], {}, (1, 2), ["a", 3],
    object(), np.zeros(3), lambda *a: 1, int,
]  # fmt: skip
PLAZA = {"scene": "plaza-v0"}
CALLS: dict[str, dict[str, Any]] = {
    "EnvConfig": {}, "RobotConfig": {}, "Reward": {}, "RobotReward": {}, "Robot": {},
    "aec_env": PLAZA, "parallel_env": PLAZA, "person_env": PLAZA, "robot_env": PLAZA,
    "demonstrations": PLAZA | {"rays": 2},
    "engine": {"name": "local"},
    "list_policies": PLAZA, "list_spawn_models": PLAZA, "load_scene": PLAZA, "recording_of": PLAZA,
    "recording": {"name": "plaza"},
    "policy": PLAZA | {"named": "straight"},
    "spawn_model": PLAZA | {"model": "poisson-gmm"},
    "read": {"path": "crowd.parquet"}, "read_own": {"path": "crowd.parquet"},
    "write_parquet": {"trajectories": None, "path": "new.parquet"},
    "rollout": PLAZA | {"spawn": "poisson-gmm", "policy": "straight", "seed": 0, "horizon_s": 5.0},
    "score": PLAZA | {"crowd": None}, "score_rollouts": PLAZA | {"crowds": None},
    "reference_rewards": PLAZA | {"seconds": 1.0, "worlds": 1, "policies": ("straight",)},
}  # fmt: skip
"""The functions and settings of the Python interface, with arguments that work."""
UNCHECKED = {"CrowdbenchError", "METRICS", "MetricResult", "Scene", "Trajectories", "distance"} | {
    "CrowdParallelEnv", "PersonEnv", "RobotEnv",  # other names of environments above
    "Demonstrations",  # what a function returns
    "evaluate", "register", "list_scenes",  # below, or without arguments
}  # fmt: skip


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return crowdbench.rollout("plaza-v0", "poisson-gmm", "straight", seed=0, horizon_s=20.0)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, crowd: Trajectories) -> None:
    monkeypatch.chdir(tmp_path)
    crowdbench.write_parquet(crowd, "crowd.parquet")


def raw(call: Callable[..., Any], given: Mapping[str, Any], name: str) -> list[str]:
    """The values of an argument that raise an error of another kind than ours."""
    found = []
    for value in HOSTILE:
        try:
            made = call(**{**given, name: value})
            if hasattr(made, "reset"):
                made.reset(seed=0)
        except CrowdbenchError:
            pass
        except Exception as error:
            found.append(f"{name}={value!r}: {type(error).__name__}: {error}")
    return found


def test_every_name_of_the_interface_is_tried() -> None:
    assert CALLS.keys() | UNCHECKED == set(crowdbench.__all__)


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize(
    "of", [pytest.param(n, marks=[pytest.mark.long] * (n == "demonstrations")) for n in CALLS]
)
def test_wrong_types_have_an_error_of_ours(of: str, crowd: Trajectories) -> None:
    call, given = getattr(crowdbench, of), dict(CALLS[of])
    for name, value in {"trajectories": crowd, "crowd": crowd, "crowds": [crowd]}.items():
        if name in given:
            given[name] = value
    for name, parameter in inspect.signature(call).parameters.items():
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            assert raw(call, given, name) == []


def test_an_evaluation_of_wrong_types_begins_not() -> None:
    given = {"scene": "plaza-v0", "out": "out", "quick": True}
    for name, value in {"workers": "two", "seeds": 1.5, "report": 3, "metric": 7, "out": 4}.items():
        with pytest.raises(SettingError, match=rf"^evaluate\({name}=…\): got "):
            crowdbench.evaluate(**{**given, name: value})  # type: ignore[arg-type]
    assert not Path("out").exists()
    with pytest.raises(SettingError, match=r"register\(name=…\): got 7 \(int\); expected a string"):
        crowdbench.register("metrics", 7, METRICS[0])  # type: ignore[arg-type]


@pytest.mark.parametrize("make", ["parallel_env", "person_env", "robot_env"])
@pytest.mark.parametrize("seed", [-1, 2.5, "1", [1], 2**70, float("nan")])
def test_seeds_are_integers_from_zero(make: str, seed: object) -> None:
    env = getattr(crowdbench, make)("plaza-v0")
    with pytest.raises(SettingError, match=r"seed: got .* expected an integer from 0 to 2⁶³ − 1"):
        env.reset(seed=seed)
    env.reset(seed=np.int64(3))


@pytest.mark.parametrize("make", ["person_env", "robot_env"])
def test_actions_of_other_types_are_refused(make: str) -> None:
    env = getattr(crowdbench, make)("plaza-v0")
    env.reset(seed=0)
    for action in ("left", b"x", {}, object(), ["a", 3], {"a": 1}, None, [np.inf, 0], 1e300):
        with pytest.raises(ActionError):
            env.step(action)


@checked()
def example(number: float, count: int = 1, name: str | Path | None = None, **more: object) -> float:
    return number * count


def test_messages_name_the_argument_its_value_and_its_type() -> None:
    with pytest.raises(SettingError) as raised:
        example(1.0, 2, 3)  # type: ignore[arg-type]
    assert str(raised.value) == "example(name=…): got 3 (int); expected a string or Path or None."
    with pytest.raises(SettingError, match=r"got 'x{59}… \(str\); expected a number"):
        example("x" * 99)  # type: ignore[arg-type]
    with pytest.raises(SettingError, match=r"got True \(bool\); expected an integer"):
        example(1.0, True)
    with pytest.raises(TypeError, match="missing a required argument: 'number'"):
        example()  # type: ignore[call-arg]


def test_numbers_of_numpy_are_numbers() -> None:
    assert example(np.float32(2.0), np.int64(3)) == 6.0  # type: ignore[arg-type]
    assert example(2, 3, unknown=object()) == 6
    assert check_seed(np.uint8(7)) == 7
