"""Writing policies as ONNX files; needs torch and the extra `onnx`."""

import logging
import subprocess
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import replacing
from crowdbench.policies.network import KEY, MOST_NOISE, OnnxPolicy, PolicyCard, check_onnx

if TYPE_CHECKING:
    import torch

TOLERANCE = 1e-5


def export_policy(
    network: "torch.nn.Module", path: Path, card: PolicyCard, *, noise: int = 0
) -> Path:
    """Write a torch network as a policy's file, and hold its actions against the network's.

    Args:
        network: called with observations (A, 5 + R) and, if `noise`, standard normal numbers
            (A, noise); returns actions (A, 2). It is not changed.
        path: the file, which is replaced.
        card: what the file is to say of it.
        noise: Z, how many random numbers it takes per person and step.

    Raises:
        SettingError: onnx, onnxruntime or onnxscript is not installed, or `noise` is out of range.
        WeightsError: the card is not right, the network cannot be written, or the file's actions
            differ from its own by more than 1e-5.
        OutputError: `path` cannot be written.
    """
    check_onnx()
    card.checked(path)
    if not 0 <= noise <= MOST_NOISE:
        raise SettingError("noise", got=str(noise), expected=f"0 to {MOST_NOISE}")
    import torch

    rng = np.random.default_rng(0)
    tried = [rng.uniform(-1, 1, (7, card.inputs)), rng.standard_normal((7, noise))]
    fed = tuple(torch.tensor(x, dtype=torch.float32) for x in tried[: 2 if noise else 1])
    training = network.training
    network.eval()
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(_onnx(network, fed, card, path))
            read = OnnxPolicy(temporary)
            with torch.no_grad():
                expected = network(*fed).numpy()
            names = ("observation", "noise")
            got = read._session.run(
                ["action"], {n: x.numpy() for n, x in zip(names, fed, strict=False)}
            )[0]
            if not np.allclose(got, expected, rtol=0, atol=TOLERANCE):
                raise WeightsError(
                    path,
                    got=f"actions that differ by {np.abs(got - expected).max():.2g}",
                    expected=f"those of the network, to {TOLERANCE:g}",
                    mend="Does it depend on anything but its inputs?",
                )
    finally:
        network.train(training)
    return path


def _onnx(
    network: "torch.nn.Module", fed: "tuple[torch.Tensor, ...]", card: PolicyCard, path: Path
) -> bytes:
    import torch

    persons = torch.export.Dim("A", min=1)
    try:
        with warnings.catch_warnings(), _quiet("torch.onnx"):
            warnings.simplefilter("ignore")  # of its own deprecations
            program = torch.onnx.export(
                network,
                fed,
                dynamo=True,
                verbose=False,
                input_names=["observation", "noise"][: len(fed)],
                output_names=["action"],
                dynamic_shapes=tuple({0: persons} for _ in fed),
            )
    except ImportError as error:
        raise SettingError(
            "policy",
            got=f"no {error.name}",
            expected="the packages that export needs",
            mend='Install them, in the clone: pip install -e ".[onnx]".',
        ) from error
    except Exception as error:  # torch's errors have no base of their own
        raise WeightsError(
            path,
            got=f"a network that torch cannot export ({str(error).splitlines()[0][:200]})",
            expected="one of standard operators that takes any number of persons",
        ) from error
    assert program is not None
    model = program.model_proto
    model.doc_string = ""
    for node in model.graph.node:  # traces of source files, with their paths
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


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Without a logger's warnings, here of operators of packages that are not installed."""
    log = logging.getLogger(name)
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def revision(folder: Path) -> str:
    """The git revision of a folder, with `-dirty` where files differ from it; empty outside git."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--abbrev=12", "--dirty"],
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
