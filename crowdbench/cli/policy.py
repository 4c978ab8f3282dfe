"""`crowdbench policy`: export a network as a policy file, or show the card of a file."""

import importlib
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cyclopts import Parameter

import crowdbench
from crowdbench.cli.running import find_own_code, new_app
from crowdbench.errors import SettingError, to_install
from crowdbench.report.text.terminal import print_facts

app = new_app("policy", "Export a trained policy to an ONNX file, or show such a file.")


@Parameter(name="*")
@dataclass(frozen=True)
class _Card:
    name: str
    """name of the policy in tables"""
    scene: str
    """id of the scene it was trained on (plaza-v0 if it was trained on none)"""
    split: str = "full"
    """split of the recording it was trained on: full, fold0, fold1 or fold2"""
    observation: str | None = None
    """observation of the policy, for example lidar-2 or social-1-contact (default: lidar-2)"""
    rays: int = 32
    """number of rays"""
    ray_range_m: float = 10.0
    """range of the rays in metres"""
    memory: int = 0
    """size of the state that the network takes and returns. Found in a zip"""
    style: int = 0
    """number of random numbers that are drawn once per person"""
    interval: int = 1
    """frames between two decisions for a person"""
    command: str = ""
    """training command, to be stored in the file"""


@app.command
def export(network: str, file: Path, /, *, noise: int = 0, of: _Card) -> None:
    """Write a torch network as an ONNX file.

    Args:
        network: pkg.module:NAME of a torch.nn.Module, or of a class or function without arguments
            that returns one; or MODEL.zip that Stable-Baselines3 or sb3-contrib saved. Reading a
            zip runs code of its pickles: only export your own
        file: file to write, FILE.onnx
        noise: standard normal numbers that the network takes per person and step. For a zip: 0 for
            the mean action, 2 to sample it
    """
    from crowdbench.files import revision
    from crowdbench.policies import PolicyCard
    from crowdbench.policies.export import export_policy
    from crowdbench.simulation.observations import OBSERVATION

    find_own_code()  # a zip may name classes of the user's own
    facts = asdict(of)
    if network.endswith(".zip"):
        module = _of_zip(network, noise, of)
        facts["memory"] = module.memory
    else:
        module = _imported(network)
    facts["observation"] = of.observation or OBSERVATION
    facts["scene"] = crowdbench.load_scene(of.scene).id
    card = PolicyCard(**facts, revision=revision(Path())).checked(file)
    export_policy(module, file, card, noise=noise)
    print(f"written to {file}")


def _of_zip(path: str, noise: int, card: _Card) -> Any:
    from crowdbench.policies.sb3 import read_sb3

    for option, value in (("--memory", card.memory), ("--style", card.style)):
        if value:
            expected = "no such option for a zip of Stable-Baselines3"
            hint = "The size of a memory is found in the zip; styles are not known there."
            raise SettingError(option, got=f"{value}", expected=expected, hint=hint)
    network = read_sb3(Path(path), noise=noise)
    if network.normalized:
        print(
            "crowdbench: the model was trained in a VecNormalize, whose statistics are not in the "
            "zip. If it normalised observations, the file will not walk as the model does.",
            file=sys.stderr,
        )
    return network


def _imported(path: str) -> Any:
    try:
        import torch
    except ImportError as error:
        expected = "torch to be installed"
        hint = to_install("fit")
        raise SettingError("policy export", got="no torch", expected=expected, hint=hint) from error
    module, _, name = path.partition(":")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SettingError(
            "network", got=f"{path!r} ({error})", expected="a pkg.module:NAME that can be imported"
        ) from error
    made = found() if callable(found) and not isinstance(found, torch.nn.Module) else found
    if not isinstance(made, torch.nn.Module):
        raise SettingError(
            "network", got=f"{path!r}, a {type(made).__name__}", expected="a torch.nn.Module"
        )
    return made


@app.command
def show(file: Path, /) -> None:
    """Check an ONNX file and print its card.

    Args:
        file: FILE.onnx
    """
    from crowdbench.policies import OnnxPolicy

    policy = OnnxPolicy(file)
    card = policy.card
    rays = f", {card.rays} rays of {card.ray_range_m:g} m" if card.with_rays else ""
    facts = {
        "trained on": card.trained_on,
        "observation": f"{card.observation}{rays} ({card.inputs} numbers)",
        "action": card.action,
        "noise": f"{policy.noise} normal numbers per person and step" if policy.noise else "none",
        "memory": f"{card.memory} numbers per person" if card.memory else "none",
        "style": f"{card.style} normal numbers per person" if card.style else "none",
        "decisions": f"every {card.interval} frames" if card.interval > 1 else "every frame",
        "command": card.command or "not stated",
        "revision": card.revision or "not stated",
        "size": f"{file.stat().st_size / 1000:.0f} kB",
    }
    print_facts(card.name, facts)
