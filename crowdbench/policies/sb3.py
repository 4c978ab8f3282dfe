"""Policies from the zip files of Stable-Baselines3 and sb3-contrib (`model.save`).

The class of the algorithm need not be known: a zip names the class of its policy and the arguments
with which that was made, and has its weights. Classes and arguments are pickles, which run code
when they are read. Of these only what the policy needs is read, which is less than what
Stable-Baselines3 itself reads. The weights are read as plain tensors.
"""

import base64
import io
import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cloudpickle
import numpy as np

from crowdbench.errors import SettingError, WeightsError, to_install

if TYPE_CHECKING:
    from crowdbench.policies.sb3_network import Sb3Network

NEEDED = ("policy_class", "observation_space", "action_space", "policy_kwargs")
TOLERANCE = 1e-5
ZIP = "a zip written by `model.save` of Stable-Baselines3"
AGAIN = "Save the model again with `model.save` of Stable-Baselines3 2.2 or newer."


def read_sb3(path: Path, *, noise: int = 0) -> "Sb3Network":
    """The network of a policy that Stable-Baselines3 or sb3-contrib saved.

    Reading such a file runs code of its pickles: read only files that you trust.

    Args:
        path: a zip written by `model.save`.
        noise: 0 for the mean action, as with `predict(deterministic=True)`; 2 for a sampled one.

    Returns:
        A network for `export_policy`: it takes observations (A, obs), normal numbers (A, 2) if
        `noise` is 2, and states (A, memory) if the policy has an LSTM.

    Raises:
        SettingError: Stable-Baselines3 is not installed, or the policy does not take this noise.
        WeightsError: the file is missing or was not saved by Stable-Baselines3, or its policy is of
            another kind: other actions or observations, or another way to find actions.
    """
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        expected = "the packages that read a model of Stable-Baselines3"
        raise SettingError(
            "policy export", got=f"no {error.name}", expected=expected, hint=to_install("sb3,onnx")
        ) from error
    if noise not in (0, 2):
        raise SettingError("noise", got=str(noise), expected="0 for the mean action, 2 to sample")
    stored, weights = _read_zip(path)
    data = {name: _unpickle(path, name, stored[name]) for name in NEEDED}
    _check_spaces(path, data["observation_space"], data["action_space"])
    policy = _policy(path, data, bool(stored.get("use_sde")), weights)
    network = _network(path, policy, noise)
    _check_actions(path, policy, network, data["observation_space"].shape[0])
    # Algorithms with an actor and a replay buffer set this item without a VecNormalize too.
    network.normalized = (
        not hasattr(policy, "actor") and stored.get("_last_original_obs") is not None
    )
    return network


def _read_zip(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Data of the model, with pickles that are not yet read, and the weights of its policy."""
    import torch

    if not path.is_file():
        raise _invalid(path, "no file", ZIP)
    try:
        with zipfile.ZipFile(path) as archive:
            stored = json.loads(archive.read("data"))
            weights = torch.load(
                io.BytesIO(archive.read("policy.pth")), map_location="cpu", weights_only=True
            )
    except Exception as error:  # each of the readers has errors of its own
        raise _invalid(path, f"a file that cannot be read ({_short(error)})", ZIP) from error
    missing = [name for name in NEEDED if name not in stored]
    if missing:
        raise _invalid(path, f"no {' and no '.join(missing)}", ZIP)
    return stored, weights


def _unpickle(path: Path, name: str, item: Any) -> Any:
    """An item of the data; what JSON cannot express is a pickle."""
    if not (isinstance(item, dict) and ":serialized:" in item):
        return item
    try:
        return cloudpickle.loads(base64.b64decode(item[":serialized:"]))
    except Exception as error:  # a pickle may raise any exception
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        module = (missing or "").split(".")[0]
        raise _invalid(
            path,
            f"a {name} that cannot be read ({_short(error)})",
            f"the package {module} to be installed"
            if module
            else "one that the installed packages can read",
            to_install("sb3") if module == "sb3_contrib" else AGAIN,
        ) from error


def _check_spaces(path: Path, observations: Any, actions: Any) -> None:
    """Check that the policy sees one vector and returns two numbers in [−1, 1]."""
    from gymnasium import spaces

    hint = "Train it in crowdbench.vec_env.CrowdVecEnv."
    if not isinstance(observations, spaces.Box) or len(observations.shape) != 1:
        found = f"a policy that observes {observations}"
        raise _invalid(path, found, "one vector, as `CrowdVecEnv` returns", hint)
    box = isinstance(actions, spaces.Box) and actions.shape == (2,)
    if not box or (actions.low != -1).any() or (actions.high != 1).any():
        expected = "Box(-1.0, 1.0, (2,), float32), as in `CrowdVecEnv`"
        raise _invalid(path, f"a policy whose actions are {actions}", expected, hint)


def _policy(path: Path, data: dict[str, Any], use_sde: bool, weights: dict[str, Any]) -> Any:
    """The policy with its weights, made as an algorithm makes it."""
    arguments = {k: v for k, v in (data["policy_kwargs"] or {}).items() if k != "device"}
    if use_sde:  # algorithms without such noise have policies that do not take it
        arguments["use_sde"] = True
    kind = data["policy_class"]
    try:
        spaces = data["observation_space"], data["action_space"]
        policy = kind(*spaces, lr_schedule=lambda _: 0.0, **arguments)
    except Exception as error:  # a policy class may be a user's own
        raise _unsupported(path, kind, f", which cannot be made ({_short(error)})") from error
    try:
        policy.load_state_dict(weights)
    except Exception as error:
        found = f"weights that do not fit ({_short(error)})"
        raise _invalid(path, found, f"those of its {_name(kind)}") from error
    policy.set_training_mode(False)
    return policy


def _network(path: Path, policy: Any, noise: int) -> "Sb3Network":
    from crowdbench.policies.sb3_network import Sb3Network

    try:
        network = Sb3Network(policy, noise)
    except (LookupError, AttributeError) as error:
        raise _unsupported(path, type(policy)) from error
    if noise and network.log_std is None:
        raise SettingError(
            "noise",
            got=f"{noise} for a {_name(type(policy))} that does not draw each action from a "
            "Gaussian",
            expected="0",
            hint="TD3 and DDPG have no randomness of their own, and generalised state-dependent "
            "exploration keeps its noise for many steps.",
        )
    return network


def _check_actions(path: Path, policy: Any, network: "Sb3Network", inputs: int) -> None:
    """Compare with `predict`: a class of the user's own may find actions in another way."""
    import torch

    rng, persons = np.random.default_rng(0), 8
    seen = rng.uniform(-1, 1, (persons, inputs)).astype(np.float32)
    states = rng.uniform(-1, 1, (2, len(network.cells), persons, network.units)).astype(np.float32)
    try:
        if network.memory:
            expected, after = policy.predict(seen, state=tuple(states), deterministic=True)
            expected = np.concatenate([expected, flat(np.stack(after))], axis=1)
        else:
            expected, _ = policy.predict(seen, deterministic=True)
        fed = [seen]
        fed += [np.zeros((persons, 2), np.float32)] if network.noise else []
        fed += [flat(states)] if network.memory else []
        with torch.no_grad():
            answer = network(*map(torch.tensor, fed))
        found = torch.cat(answer, dim=1) if isinstance(answer, tuple) else answer
        alike = np.allclose(found.numpy(), expected, rtol=0, atol=TOLERANCE)
    except Exception as error:  # what a user's own class does is not known
        raise _unsupported(path, type(policy)) from error
    if not alike:
        raise _unsupported(path, type(policy))


def flat(states: np.ndarray) -> np.ndarray:
    """States of Stable-Baselines3 (2, layers, A, units) as those of a policy file (A, M)."""
    persons = states.shape[2]
    return np.ascontiguousarray(np.moveaxis(states, 2, 0).reshape(persons, -1))


def _unsupported(path: Path, kind: Any, reason: str = "") -> WeightsError:
    return WeightsError(
        path,
        got=f"a policy of the class {_name(kind)}{reason}",
        expected="an ActorCriticPolicy (PPO, A2C, TRPO), a RecurrentActorCriticPolicy "
        "(RecurrentPPO), or a policy with the actor of SAC, TQC, TD3 or DDPG",
        hint="Wrap it in a torch.nn.Module that returns its actions, and name that instead of the "
        "zip.",
    )


def _invalid(path: Path, got: str, expected: str, hint: str = AGAIN) -> WeightsError:
    return WeightsError(path, got=" ".join(got.split())[:240], expected=expected, hint=hint)


def _name(of: Any) -> str:
    return str(getattr(of, "__name__", of))


def _short(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
