"""Policies of Stable-Baselines3 and sb3-contrib as files: they walk as the models themselves do."""

import sys
import zipfile
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from conftest import need_sb3

need_sb3()

import stable_baselines3 as sb3  # noqa: E402
import torch  # noqa: E402
from gymnasium import spaces  # noqa: E402
from sb3_contrib import ARS, TQC, TRPO, RecurrentPPO  # noqa: E402
from stable_baselines3.common.policies import ActorCriticPolicy  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from crowdbench import load_scene, rollout, spawn_model  # noqa: E402
from crowdbench.cli import main  # noqa: E402
from crowdbench.data.table import OUTCOMES  # noqa: E402
from crowdbench.errors import SettingError, WeightsError  # noqa: E402
from crowdbench.policies import Memory, OnnxPolicy  # noqa: E402
from crowdbench.policies.rows import GRID  # noqa: E402
from crowdbench.policies.sb3 import flat, read_sb3  # noqa: E402
from crowdbench.scene import Scene  # noqa: E402

INPUTS = 6 + 32  # lidar-2
PLAZA = load_scene("plaza-v0")
ASKED = ["--name", "walker", "--scene", "plaza-v0"]
ACTIONS = spaces.Box(-1.0, 1.0, (2,), np.float32)
LAYERS, UNITS = 2, 12


class Fake(gymnasium.Env):
    """An environment of some spaces, in which nothing happens."""

    def __init__(
        self, inputs: int | spaces.Space = INPUTS, action_space: spaces.Space = ACTIONS
    ) -> None:
        vector = isinstance(inputs, int)
        self.observation_space = spaces.Box(-1.0, 1.0, (inputs,)) if vector else inputs
        self.action_space = action_space

    def reset(self, **_: Any) -> tuple[Any, dict]:  # type: ignore[override]
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        return self.observation_space.sample(), 0.0, False, False, {}


def model_of(algorithm: Any, policy: Any = "MlpPolicy", **options: Any) -> Any:
    """A model whose actions differ much with what it sees."""
    env = options.pop("env", None) or Fake()
    model = algorithm(policy, env, device="cpu", seed=0, **options)
    with torch.no_grad():
        for name, weights in model.policy.named_parameters():
            if "log_std" not in name:
                weights += 0.2 * torch.randn_like(weights)
    return model


def recurrent(**options: Any) -> Any:
    sizes = {"lstm_hidden_size": UNITS, "n_lstm_layers": LAYERS}
    return model_of(RecurrentPPO, "MlpLstmPolicy", policy_kwargs=sizes, **options)


def exported(model: Any, folder: Path, *options: str) -> OnnxPolicy:
    """The policy of a model, after `model.save` and the command."""
    model.save(folder / "model.zip")
    file = folder / "walker.onnx"
    assert main(["policy", "export", str(folder / "model.zip"), str(file), *ASKED, *options]) == 0
    return OnnxPolicy(file)


class Beside:
    """Walks as the model does, and says how far the file's actions are from that."""

    name, sees = "beside", "observation"

    def __init__(self, model: Any, file: OnnxPolicy) -> None:
        self.model, self.file = model, file
        self.memory = max(1, file.memory)  # at least 1, to be told who is who
        self.observation, self.rays = file.observation, file.rays
        self.states: dict[int, np.ndarray] = {}
        self.steps: dict[int, int] = {}
        self.apart = 0.0

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.file.reset(scene, rng)

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        new = np.zeros((2, LAYERS, UNITS), np.float32)
        states = np.stack([self.states.get(p, new) for p in memory.person.tolist()], axis=2)
        states = states if self.file.memory else None
        expected, after = self.model.predict(
            seen, state=None if states is None else tuple(states), deterministic=True
        )
        found = self.file.act(seen, memory if self.file.memory else None)
        self.apart = max(self.apart, float(np.abs(found - expected).max()))
        for k, person in enumerate(memory.person.tolist()):
            self.steps[person] = self.steps.get(person, 0) + 1
            if after is not None:
                self.states[person] = np.stack(after)[:, :, k]
        if after is not None:
            assert np.abs(flat(np.stack(after)) - memory.state).max() < 20 * GRID  # rounded
        return found  # crowds are chaotic: small differences of states would be other crowds


@pytest.mark.parametrize("make", [lambda: model_of(sb3.PPO), recurrent], ids=["ppo", "recurrent"])
def test_a_file_walks_as_the_model_does_while_people_come_and_go(make: Any, tmp_path: Path) -> None:
    model = make()
    policy = exported(model, tmp_path)
    assert policy.memory == (2 * LAYERS * UNITS if isinstance(model, RecurrentPPO) else 0)
    assert policy.deterministic
    beside = Beside(model, policy)
    spawn = spawn_model("poisson-gmm", PLAZA)
    crowd = rollout(PLAZA, spawn, beside, seed=0, horizon_s=90.0, start="empty")
    assert beside.apart < (20 * GRID if policy.memory else 1e-4)
    assert (crowd.outcome != OUTCOMES.index("horizon")).sum() > 10  # many have left
    assert len(beside.steps) > 20
    assert len(set(beside.steps.values())) > 10  # trips of different lengths
    alone = rollout(PLAZA, spawn, policy, seed=0, horizon_s=90.0, start="empty")
    np.testing.assert_allclose(alone.xy, crowd.xy, atol=1e-2)


@pytest.mark.parametrize("algorithm", [sb3.A2C, TRPO, sb3.SAC, TQC, sb3.TD3, sb3.DDPG])
def test_other_algorithms_are_read_without_being_named(algorithm: Any, tmp_path: Path) -> None:
    model = model_of(algorithm)
    model.save(tmp_path / "model.zip")
    seen = np.random.default_rng(1).uniform(-1, 1, (50, INPUTS)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    assert np.ptp(expected) > 0.5
    with torch.no_grad():
        found = read_sb3(tmp_path / "model.zip")(torch.tensor(seen))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["ppo", "recurrent", "sac"])
def test_sampled_actions_are_spread_as_those_of_the_model(kind: str, tmp_path: Path) -> None:
    if kind == "sac":
        model = sb3.SAC("MlpPolicy", Fake(), device="cpu", seed=0)
    elif kind == "ppo":
        model = sb3.PPO("MlpPolicy", Fake(), device="cpu", policy_kwargs={"log_std_init": -2.0})
    else:
        small = {"log_std_init": -2.0, "lstm_hidden_size": 8}
        model = RecurrentPPO("MlpLstmPolicy", Fake(), device="cpu", policy_kwargs=small)
    policy = exported(model, tmp_path, "--noise", "2")
    assert (policy.noise, policy.deterministic) == (2, False)
    policy.reset(PLAZA, np.random.default_rng(0))
    rows = 20_000
    seen = np.full((rows, INPUTS), 0.3, np.float32)
    state = np.zeros((rows, policy.memory), np.float32)
    who = np.arange(rows)
    new = np.ones(rows, bool)
    memory = Memory(state=state, style=state[:, :0], world=0 * who, person=who, entered=new)
    drawn = policy.act(seen, memory if policy.memory else None)
    torch.manual_seed(0)
    expected, _ = model.predict(seen, deterministic=False)
    if kind != "sac":
        assert drawn.std(axis=0) == pytest.approx(np.exp([-2.0, -2.0]), rel=0.03)
    assert drawn.std(axis=0) == pytest.approx(expected.std(axis=0), rel=0.03)
    assert drawn.mean(axis=0) == pytest.approx(expected.mean(axis=0), abs=0.02)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.03


class Mirrored(ActorCriticPolicy):
    """A class of a user's own that finds its actions in another way."""

    def _predict(self, observation: torch.Tensor, deterministic: bool = False) -> torch.Tensor:
        return -super()._predict(observation, deterministic)


def saved(model: Any, folder: Path) -> Path:
    model.save(folder / "model.zip")
    return folder / "model.zip"


DICT = spaces.Dict({"seen": spaces.Box(-1.0, 1.0, (4,))})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sb3.PPO("MlpPolicy", Fake(action_space=spaces.Discrete(4))), r"Discrete\(4\)"),
        (lambda: sb3.DQN("MlpPolicy", Fake(action_space=spaces.Discrete(4)), buffer_size=10),
         r"actions are Discrete\(4\); expected Box"),
        (lambda: sb3.PPO("MlpPolicy", Fake(action_space=spaces.Box(-5.0, 5.0, (2,)))),
         r"actions are Box\(-5"),
        (lambda: sb3.PPO("MlpPolicy", Fake(action_space=spaces.Box(-1.0, 1.0, (3,)))), r"\(3,\)"),
        (lambda: sb3.PPO("MultiInputPolicy", Fake(DICT)), r"observes Dict\("),
        (lambda: ARS("LinearPolicy", Fake()), "class ARSLinearPolicy, which"),
        (lambda: model_of(sb3.PPO, Mirrored), "class Mirrored"),
    ],
    ids=["discrete", "dqn", "wide", "three", "dict", "ars", "own"],
)  # fmt: skip
def test_policies_of_other_kinds_are_refused(make: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=words):
        read_sb3(saved(make(), tmp_path))


def test_what_cannot_be_sampled_is_refused(tmp_path: Path) -> None:
    path = saved(model_of(sb3.PPO), tmp_path)
    with pytest.raises(SettingError, match="got 1; expected 0 for the mean action, 2 to sample"):
        read_sb3(path, noise=1)
    with pytest.raises(SettingError, match="got 2 for a TD3Policy"):
        read_sb3(saved(model_of(sb3.TD3), tmp_path), noise=2)
    assert read_sb3(saved(model_of(sb3.PPO, use_sde=True), tmp_path)).noise == 0
    with pytest.raises(SettingError, match="state-dependent exploration"):
        read_sb3(path, noise=2)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    with pytest.raises(WeightsError, match="got no file"):
        read_sb3(path)
    path.write_text("no zip")
    with pytest.raises(WeightsError, match="BadZipFile"):
        read_sb3(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("notes.txt", "nothing")
    with pytest.raises(WeightsError, match=r"no item named 'data'[\s\S]*written by `model.save`"):
        read_sb3(path)


def rewritten(path: Path, old: bytes, new: bytes) -> None:
    """Replace some bytes of the model's data."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert old in files["data"]
    files["data"] = files["data"].replace(old, new)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def test_damaged_models_are_refused(tmp_path: Path) -> None:
    path = saved(model_of(sb3.PPO), tmp_path)
    rewritten(path, b'"policy_class"', b'"policy_name"')
    with pytest.raises(WeightsError, match="got no policy_class"):
        read_sb3(path)
    path = saved(model_of(sb3.PPO, policy_kwargs={"net_arch": [4]}), tmp_path)
    rewritten(path, b'"net_arch": [\n            4', b'"net_arch": [\n            5')
    with pytest.raises(WeightsError, match=r"weights that do not fit[\s\S]*size mismatch"):
        read_sb3(path)


def test_only_what_is_needed_is_unpickled(tmp_path: Path) -> None:
    path = saved(model_of(sb3.PPO), tmp_path)
    rewritten(path, b'"lr_schedule": {', b'"lr_schedule": {":serialized:": "damaged", "was": {}, ')
    read_sb3(path)


def test_missing_packages_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(recurrent(), tmp_path)
    with monkeypatch.context() as patched:
        for name in [n for n in sys.modules if n.split(".")[0] == "sb3_contrib"]:
            patched.delitem(sys.modules, name)
        patched.setitem(sys.modules, "sb3_contrib", None)
        with pytest.raises(WeightsError, match=r"package sb3_contrib[\s\S]*\[sb3\]"):
            read_sb3(path)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(SettingError, match=r"no stable_baselines3[\s\S]*\[sb3,onnx\]"):
        read_sb3(path)


class TestCommand:
    """What the command says."""

    others: ClassVar[list[str]] = ["no.onnx", *ASKED]

    def told(self, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
        assert main(["policy", "export", *arguments]) == 2
        assert not Path("no.onnx").exists()
        return capsys.readouterr().err

    def test_options_that_do_not_fit(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        model_of(sb3.PPO, env=Fake(102)).save("model.zip")
        error = self.told(capsys, "model.zip", *self.others)
        assert "takes 102 numbers" in error
        assert "no.onnx" in error
        assert "--memory: got 3" in self.told(capsys, "model.zip", *self.others, "--memory", "3")
        assert "--style: got 3" in self.told(capsys, "model.zip", *self.others, "--style", "3")

    def test_the_size_of_what_it_sees_tells_which_observation_it_is(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        from crowdbench.simulation.observations import size_of

        monkeypatch.chdir(tmp_path)
        model_of(sb3.PPO, env=Fake(size_of("social-1", 32))).save("model.zip")
        assert "This is the size of social-1" in self.told(capsys, "model.zip", *self.others)

    def test_a_model_of_normalised_observations_is_told(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        env = VecNormalize(DummyVecEnv([Fake]))
        model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=8, n_epochs=1, device="cpu")
        model.learn(8).save("model.zip")
        assert main(["policy", "export", "model.zip", "walker.onnx", *ASKED]) == 0
        assert "VecNormalize" in capsys.readouterr().err
