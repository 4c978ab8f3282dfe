"""Policy files: a network in one ONNX file, with a card that describes its inputs.

A file has the input `observation`, float32 (A, inputs of the card), and the output `action`,
float32 (A, 2), where the number of persons A is free. A stochastic policy has a second input
`noise`, float32 (A, Z): standard normal numbers that the rollout draws for each person and step, so
that the same seed gives the same crowd. A policy that remembers people has the input `state` and
the output `next_state`, float32 (A, M): zeros when a person enters, then what the network returned
for it, rounded (`rows.kept`). The input `style`, float32 (A, S), is drawn like noise, but once per
person. M and S are in the card. Operators that draw random numbers are rejected. Each action must
be computed from the person's own row, which `crowdbench.policies.rows` tests. The metadata contain
a `PolicyCard` as JSON under the key `crowdbench`. A file can only contain standard ONNX operators,
which onnxruntime executes: no pickle, no custom operators and no external data.
"""

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import msgspec
import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.errors import SettingError, WeightsError, to_install
from crowdbench.files import read_bytes
from crowdbench.policies.card import HINT, PolicyCard
from crowdbench.policies.memory import Memory
from crowdbench.policies.onnx_runtime import LONGEST_S, CallLimit, runtime
from crowdbench.policies.rows import ROWS, Watch, check_rows, in_parts, kept
from crowdbench.scene import Scene
from crowdbench.simulation.social import with_velocities_times

if TYPE_CHECKING:
    from google.protobuf.message import Message
    from onnx import ModelProto, ValueInfoProto

KEY = "crowdbench"
LARGEST = 20_000_000  # bytes
MOST_NOISE = 256
Shape = tuple[int | None, ...]
"""Shape of an input or output, with None for the free number of persons."""
_STANDARD = ("", "ai.onnx")
_DRAWING = frozenset({
    "Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform",
    "RandomUniformLike",
})  # fmt: skip


class OnnxPolicy:
    """A policy from an ONNX file; needs the extra `onnx`."""

    sees: ClassVar[Literal["observation"]] = "observation"
    many_worlds: ClassVar[bool] = True
    kind: ClassVar[type[PolicyCard]] = PolicyCard
    """The kind of card that its files have."""

    def __init__(self, path: str | Path) -> None:
        """Read and check the file.

        Raises:
            WeightsError: it is missing, too large, not ONNX, or not a valid policy file.
            SettingError: onnx or onnxruntime is not installed.
        """
        self.path = Path(path)
        self.card, self.noise, self._session = _open(self.path, self.kind)
        card = self.card
        self.name, self.observation = card.name, card.observation
        self.rays, self.ray_range_m = card.rays, card.ray_range_m
        self.memory, self.style, self.interval = card.memory, card.style, card.interval
        self.deterministic = self.noise == self.style == 0
        self._watch = Watch(self.path)
        self._parts = np.random.default_rng(0)
        self._limit = CallLimit()
        self._unit = 1.0

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode whose noise is drawn from `rng`."""
        own = self.card.max_speed_mps
        self._unit = 1.0 if own is None else scene.motion.max_speed_mps / own
        self._rng = rng
        self._watch = Watch(self.path)
        self._parts = np.random.default_rng(0)

    def act(
        self, seen: Float32[np.ndarray, "A obs"], memory: Memory | None = None
    ) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2), one per observation; the next states are written to `memory`.

        Noise that `memory` does not have is drawn from the generator of `reset`.

        Raises:
            SettingError: the observations are of another size than the network's.
            WeightsError: the network cannot be run, or a test found that it mixes rows.
        """
        self.card.check_width(seen.shape[1])
        own = seen if self._unit == 1 else with_velocities_times(self._unit, seen)
        fed = {"observation": np.ascontiguousarray(own, dtype=np.float32)}
        if self.noise and (memory is None or memory.noise.size == 0):
            fed["noise"] = self._rng.standard_normal((len(seen), self.noise), dtype=np.float32)
        if memory is not None:
            inputs = {"state": memory.state, "style": memory.style, "noise": memory.noise}
            fed |= {name: values for name, values in inputs.items() if values.shape[1]}
        answer = in_parts(self._run, fed, self._parts) if self.memory else self._run(fed)
        self._watch.look(self._run, fed, answer)
        if memory is not None:
            memory.state[:] = kept(answer[:, 2:])
        return answer[:, :2] / np.float32(self._unit)

    def check_rows(self, where: object = None) -> None:
        """Check row independence on random observations.

        `where` is named in error messages.

        Raises:
            WeightsError: the network mixes rows or cannot be run.
        """
        check_rows(where or self.path, self._run, random_inputs(self.card, self.noise, ROWS))

    def _run(self, fed: dict[str, np.ndarray]) -> Float32[np.ndarray, "A _"]:
        return np.concatenate(
            _called(self.path, self._session, self.card, fed, self._limit), axis=1
        )


def _called(
    path: Path, session: Any, card: PolicyCard, fed: dict[str, np.ndarray], limit: CallLimit
) -> list[np.ndarray]:
    """What a network returns.

    Raises:
        WeightsError: it cannot be run, or takes too long.
    """
    try:
        with limit as options:
            found: list[np.ndarray] = session.run(list(card.output_sizes), fed, options)
    except Exception as error:  # onnxruntime's errors have no common base class
        if not limit.exceeded:
            raise _unrunnable(path, error) from error
        got = f"no answer for {len(fed['observation'])} persons in {LONGEST_S:g} s"
        raise _invalid(path, got, "a network that answers in milliseconds") from error
    return found


def random_inputs(
    card: PolicyCard, noise: int, persons: int, seed: int = 0
) -> dict[str, np.ndarray]:
    """Random values of all inputs of a network, float32 (persons, size), in their order."""
    rng = np.random.default_rng(seed)
    seen = rng.uniform(-1, 1, (persons, card.inputs)).astype(np.float32)
    return {
        name: rng.standard_normal((persons, size), dtype=np.float32) if fed else seen
        for fed, (name, size) in enumerate(card.input_sizes(noise).items())
    }


def check_onnx(*more: str) -> None:
    """Check that the packages for ONNX files are installed, and `more` packages.

    Raises:
        SettingError: one is not installed.
    """
    for package in ("onnx", "onnxruntime", *more):
        if find_spec(package) is None:
            got = f"no {package}"
            expected = "the packages for ONNX files"
            raise SettingError("policy", got=got, expected=expected, hint=to_install("onnx"))


def read_card(path: Path) -> PolicyCard:
    """Card of a policy file. The network itself is not checked.

    Raises:
        WeightsError: the file is missing, too large, not ONNX, or has no valid card.
        SettingError: onnx or onnxruntime is not installed.
    """
    return _card_of(path, _read_model(path)[1])


def _read_model(path: Path) -> tuple[bytes, "ModelProto"]:
    """Content of a file, as bytes and as an ONNX model."""
    check_onnx()
    import onnx
    from google.protobuf.message import DecodeError

    if path.is_file() and path.stat().st_size > LARGEST:
        got = f"{path.stat().st_size / 1e6:.1f} MB"
        raise WeightsError(path, got=got, expected=f"an ONNX file of up to {LARGEST / 1e6:.0f} MB")
    data = read_bytes(path, WeightsError, HINT)
    try:
        return data, onnx.ModelProto.FromString(data)
    except (DecodeError, ValueError) as error:
        raise _invalid(path, f"invalid data ({error})", "an ONNX file") from error


def _open(path: Path, kind: type[PolicyCard]) -> tuple[PolicyCard, int, Any]:
    data, model = _read_model(path)
    onnxruntime = runtime()
    card = _card_of(path, model, kind)
    _check_operators(path, model)
    noise = _check_shapes(path, model, card)
    options = onnxruntime.SessionOptions()
    # One thread: several threads add sums in varying order and do not speed up small networks.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(
            data, options, providers=["CPUExecutionProvider"], enable_fallback=False
        )
        _try(path, session, card, noise)
    except WeightsError:
        raise
    except Exception as error:  # onnxruntime's errors have no common base class
        raise _unrunnable(path, error) from error
    return card, noise, session


def _unrunnable(path: Path, error: Exception) -> WeightsError:
    told = (str(error) or type(error).__name__).splitlines()[0][:150]
    return _invalid(path, f"a network that onnxruntime cannot run ({told})", "one that runs")


def _card_of(path: Path, model: "ModelProto", kind: type[PolicyCard] = PolicyCard) -> PolicyCard:
    found = [entry.value for entry in model.metadata_props if entry.key == KEY]
    if len(found) != 1:
        found_entries = f"{len(found)} metadata entries {KEY!r}"
        raise _invalid(path, found_entries, "one entry with the policy's card")
    try:
        # protobuf returns text that is not UTF-8 as bytes.
        text = found[0] if isinstance(found[0], bytes) else found[0].encode()
        card = msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _invalid(path, f"an invalid card ({error})", "a valid card") from error
    return card.checked(path)


def _check_operators(path: Path, model: "ModelProto") -> None:
    """Reject non-standard operators, operators that draw random numbers, and external data."""
    from onnx import NodeProto, TensorProto

    if model.functions:
        raise _invalid(path, "custom functions", "operators of the ONNX standard")
    for part in _parts(model.graph):
        if isinstance(part, NodeProto):
            if part.domain not in _STANDARD:
                found = f"the operator {part.domain}.{part.op_type}"
                raise _invalid(path, found, "operators of the ONNX standard")
            # Dropout draws random numbers if its third input (training mode) is set.
            in_training = part.op_type == "Dropout" and any(part.input[2:])
            if part.op_type in _DRAWING or in_training:
                raise _invalid(
                    path,
                    f"the operator {part.op_type}, which draws random numbers",
                    "the input noise (A, Z) instead, so that the same seed gives the same crowd",
                )
        if isinstance(part, TensorProto) and (
            part.external_data or part.data_location == part.EXTERNAL
        ):
            raise _invalid(
                path,
                f"the tensor {part.name!r}, whose data is in another file",
                "all weights in this file",
                hint="Save the model without external data.",
            )


def _parts(message: "Message") -> "Iterator[Message]":
    """A message and all messages in it: nodes, tensors and nested graphs among them."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in value if isinstance(value, Sequence) else (value,):
                yield from _parts(inner)


def _invalid(path: Path, got: str, expected: str, hint: str = HINT) -> WeightsError:
    return WeightsError(path, got=got[:200], expected=expected, hint=hint)


def _check_shapes(path: Path, model: "ModelProto", card: PolicyCard) -> int:
    """Check inputs and outputs and return the width Z of the noise, 0 without noise."""
    fixed = {tensor.name for tensor in model.graph.initializer}
    inputs = {i.name: _shape(i) for i in model.graph.input if i.name not in fixed}
    outputs = {o.name: _shape(o) for o in model.graph.output}
    noise = inputs.pop("noise", None)
    expected: dict[str, Shape] = {n: (None, size) for n, size in card.input_sizes(0).items()}
    if inputs != expected:
        raise _invalid(
            path,
            f"inputs {_describe(inputs)}",
            f"float32 {_describe(expected)} and optionally noise (A, Z): "
            f"{card.observation}{card.with_rays} has {card.inputs} numbers",
        )
    returned: dict[str, Shape] = {name: (None, size) for name, size in card.output_sizes.items()}
    if outputs != returned:
        raise _invalid(path, f"outputs {_describe(outputs)}", f"float32 {_describe(returned)}")
    if noise is None:
        return 0
    width = noise[1] if noise[0] is None and len(noise) == 2 else None
    if width is None or not 1 <= width <= MOST_NOISE:
        expected_noise = f"float32 noise (A, Z) with Z from 1 to {MOST_NOISE}"
        raise _invalid(path, _describe({"noise": noise}), expected_noise)
    return width


def _shape(value: "ValueInfoProto") -> Shape:
    """Shape with None for free sizes; (−1,) if the value is not a float32 array."""
    tensor = value.type.tensor_type
    if tensor.elem_type != 1 or not tensor.HasField("shape"):
        return (-1,)
    return tuple(d.dim_value if d.HasField("dim_value") else None for d in tensor.shape.dim)


def _describe(shapes: dict[str, Shape]) -> str:
    def size(shape: Shape) -> str:
        if shape == (-1,):
            return "of another type"
        return "(" + ", ".join("A" if d is None else str(d) for d in shape) + ")"

    return ", ".join(f"{name} {size(shape)}" for name, shape in shapes.items())[:300] or "none"


def _try(path: Path, session: Any, card: PolicyCard, noise: int) -> None:
    """Run the network for one and for three persons and check what it returns."""
    for persons in (1, 3):
        answers = _called(path, session, card, random_inputs(card, noise, persons), CallLimit())
        for (name, size), answer in zip(card.output_sizes.items(), answers, strict=True):
            if answer.shape != (persons, size) or answer.dtype != np.float32:
                raise _invalid(
                    path,
                    f"{answer.dtype} {name} of shape {answer.shape} for {persons} persons",
                    f"float32 {name} of shape ({persons}, {size})",
                )
            if not np.isfinite(answer).all():
                raise _invalid(path, f"values of {name} that are not finite", "finite numbers")
