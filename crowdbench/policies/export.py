"""Export of policies to ONNX files; needs torch and the extra `onnx`."""

import logging
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import replacing
from crowdbench.policies.card import PolicyCard
from crowdbench.policies.network import KEY, MOST_NOISE, OnnxPolicy, check_onnx, random_inputs
from crowdbench.simulation.observations import BUILT_IN, size_of

if TYPE_CHECKING:
    import torch

TOLERANCE = 1e-5
TRIAL = "import sys; from {0.__module__} import {0.__name__}; {0.__name__}(sys.argv[1])"


def export_policy(
    network: "torch.nn.Module",
    path: Path,
    card: PolicyCard,
    *,
    noise: int = 0,
    reader: type[OnnxPolicy] = OnnxPolicy,
) -> Path:
    """Write a torch network as a policy file and check that the file gives the same actions.

    Args:
        network: takes observations (A, card.inputs) and, as far as their sizes are positive, in
            this order: standard normal numbers (A, noise), the states (A, card.memory), and the
            styles (A, card.style). Returns actions (A, 2), or with a memory actions and next
            states (A, card.memory). It is not changed.
        path: the file to write; an existing file is replaced.
        card: metadata of the file.
        noise: number Z of random numbers that the network takes per person and step.
        reader: the class that reads files with such a card.

    Returns:
        `path`.

    Raises:
        SettingError: onnx, onnxruntime or onnxscript is not installed, or `noise` is out of range.
        WeightsError: the card is invalid, the network does not match the card or cannot be
            exported, the file's actions differ from those of the network by more than 1e-5, or the
            network mixes rows.
        OutputError: `path` cannot be written.
    """
    check_onnx("onnxscript")
    card.checked(path)
    if not 0 <= noise <= MOST_NOISE:
        raise SettingError("noise", got=str(noise), expected=f"0 to {MOST_NOISE}")
    import torch

    fed = {name: torch.tensor(x) for name, x in random_inputs(card, noise, 7).items()}
    training = network.training
    network.eval()
    try:
        expected = _answer(network, fed, card, path)
        with replacing(path) as temporary:
            temporary.write_bytes(_onnx(network, fed, card, path))
            _check_survival(temporary, path, reader)
            read = reader(temporary)
            got = read._run({name: x.numpy() for name, x in fed.items()})
            if not np.allclose(got, expected, rtol=0, atol=TOLERANCE):
                raise WeightsError(
                    path,
                    got=f"actions that differ by {np.abs(got - expected).max():.2g}",
                    expected=f"the actions of the network, within {TOLERANCE:g}",
                    hint="Check whether the network depends on anything except its inputs.",
                )
            read.check_rows(path)
    finally:
        network.train(training)
    return path


def _answer(
    network: "torch.nn.Module", fed: "dict[str, torch.Tensor]", card: PolicyCard, path: Path
) -> np.ndarray:
    """Actions and next states (A, 2 + M) of the network, before it is traced.

    Its own errors are clearer than those of the export.
    """
    import torch

    inputs = tuple(fed.values())
    try:
        with torch.no_grad():
            found = network(*inputs)
    except Exception as error:  # a user's network may raise any exception
        takes = _takes(network, inputs)
        version = {size_of(name, card.rays): name for name in BUILT_IN}.get(takes or -1)
        others = "".join(f", and {n} of shape {tuple(x.shape)}" for n, x in [*fed.items()][1:])
        raise WeightsError(
            path,
            got=f"a network that takes {takes} numbers"
            if takes
            else f"a network that raises {type(error).__name__}: "
            + (str(error).splitlines() or [""])[0][:200],
            expected=f"one that takes observations of shape (A, {card.inputs}): {card.observation} "
            f"has {card.inputs} numbers{card.with_rays}{others}",
            hint=f"This is the size of {version}; set it as the observation."
            if version
            else "State the observation and rays that it was trained with."
            if takes
            else "State the observation, rays, noise, memory and style that it was trained with.",
        ) from error
    parts = list(found) if isinstance(found, tuple) and card.memory else [found]
    persons = len(inputs[0])
    shapes = [tuple(p.shape) if isinstance(p, torch.Tensor) else type(p).__name__ for p in parts]
    if shapes != [(persons, size) for size in card.output_sizes.values()]:
        got = (
            " and ".join(f"of shape {s}" if isinstance(s, tuple) else f"a {s}" for s in shapes)
            or "nothing"
        )
        raise WeightsError(
            path,
            got=f"a network that returns {got} for {persons} persons",
            expected=f"one tensor of actions ({persons}, 2)"
            if not card.memory
            else f"actions ({persons}, 2) and next states ({persons}, {card.memory})",
            hint="Wrap it in a module that returns only the actions."
            if not card.memory
            else "Wrap it in a module that returns both, or set the card's memory to the size of "
            "the state.",
        )
    return np.concatenate([part.numpy() for part in parts], axis=1)


def _takes(network: "torch.nn.Module", fed: "tuple[torch.Tensor, ...]") -> int | None:
    """Number of values of an observation that the network takes; None if it cannot be found."""
    import torch

    sizes = {p.shape[-1] for p in network.parameters() if p.dim() > 1}
    for size in sorted(sizes, reverse=True):
        try:
            with torch.no_grad():
                network(torch.zeros(len(fed[0]), size), *fed[1:])
        except Exception:  # not this size
            continue
        return int(size)
    return None


def _check_survival(file: Path, path: Path, reader: type[OnnxPolicy]) -> None:
    """Run the file in a separate process first, because some networks crash onnxruntime."""
    command = [sys.executable, "-c", TRIAL.format(reader), str(file)]
    path_of_modules = {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, env=os.environ | path_of_modules, capture_output=True)
    if done.returncode < 0:
        got = f"a network that crashes onnxruntime with signal {-done.returncode}"
        hint = "Use other operators; recurrent layers are often the cause."
        raise WeightsError(path, got=got, expected="one that runs", hint=hint)


def _onnx(
    network: "torch.nn.Module", fed: "dict[str, torch.Tensor]", card: PolicyCard, path: Path
) -> bytes:
    import torch

    persons = torch.export.Dim("A", min=1)
    log = logging.getLogger("torch.onnx")
    level = log.level
    try:
        log.setLevel(logging.ERROR)  # without warnings on operators of packages not installed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch warns of its own deprecations
            program = torch.onnx.export(
                network,
                tuple(fed.values()),
                dynamo=True,
                verbose=False,
                input_names=list(fed),
                output_names=list(card.output_sizes),
                dynamic_shapes=tuple({0: persons} for _ in fed),
            )
    except Exception as error:  # torch's errors have no common base class
        got = f"a network that torch cannot export ({str(error).splitlines()[0][:200]})"
        expected = "one with standard operators that takes any number of persons"
        raise WeightsError(path, got=got, expected=expected) from error
    finally:
        log.setLevel(level)
    assert program is not None
    model = program.model_proto
    model.doc_string = ""
    for node in model.graph.node:  # remove traces, which contain paths of source files
        node.doc_string = ""
        del node.metadata_props[:]
    del model.graph.metadata_props[:]
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info):
        del value.metadata_props[:]
    for tensor in model.graph.initializer:
        del tensor.metadata_props[:]
    del model.metadata_props[:]
    entry = model.metadata_props.add()
    entry.key, entry.value = KEY, msgspec.json.encode(card).decode()
    data: bytes = model.SerializeToString(deterministic=True)
    return data
