"""The worlds of a simulation on a CUDA device.

`CudaSimulation` copies the state of a `Simulation` to the device and simulates there: it moves
people and computes observations and rewards. Nothing is copied to the CPU. The functions of one
person are those of the CPU, see `crowdbench.simulation.cuda_kernels`. Results may differ in the
last digits, because the device's fused multiply-add rounds a product and a sum once, not twice.

It needs numba-cuda (extra `gpu`), or numba's simulator of CUDA on the CPU
(`NUMBA_ENABLE_CUDASIM=1` and `NUMBA_DISABLE_JIT=1`), which is for tests of a few people.
"""

import sys
from collections.abc import Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np

from crowdbench.errors import SettingError, to_install
from crowdbench.simulation.observations import OBSERVATIONS
from crowdbench.simulation.reward import PARTS, Reward
from crowdbench.simulation.simulation import Simulation

Bundle = TypeVar("Bundle")

THREADS = 128
"""Threads per block of kernels with a thread per slot."""
MOST_THREADS = 1024
"""Largest number of threads in a block, of any device."""
WARP = 32
"""Threads that a device runs together."""


@cache
def cuda_module() -> Any:
    """The module `numba.cuda`.

    Raises:
        SettingError: there is no device, or no numba-cuda.
    """
    try:
        from numba import cuda

        found = cuda.is_available()  # type: ignore[no-untyped-call]
    except ImportError as error:
        raise SettingError(
            "device", got="cuda without numba-cuda", expected="cpu", hint=to_install("gpu")
        ) from error
    if not found:
        hint = "Install NVIDIA's driver, and the extra gpu. Or use the device cpu."
        raise SettingError("device", got="cuda without a CUDA device", expected="cpu", hint=hint)
    return cuda


@cache
def _kernels(corners: int) -> Any:
    from crowdbench.simulation.cuda_kernels import kernels

    return kernels(corners)


class CudaSimulation:
    """`W` worlds of `N` slots on a CUDA device, with the state of a `Simulation`.

    All arrays are numba's arrays on the device, which `torch.as_tensor(array, device="cuda")` shows
    without copying. Kernels run on torch's present stream if torch is loaded, so a CUDA graph of
    torch can record a step.

    Observations are those of `OBSERVATIONS`; others are computed on the CPU only.
    """

    def __init__(self, simulation: Simulation, reward: Reward | None = None) -> None:
        """Copy the state of a simulation, whose `observe` has been called, to the device.

        Raises:
            SettingError: there is no device, or the observation is one that adds numbers to a
                built-in one.
        """
        self._cuda = cuda_module()
        shown = simulation.settings.shown
        if shown.observation not in OBSERVATIONS:
            raise SettingError(
                "observation",
                got=repr(shown.observation),
                expected=f"one of {', '.join(OBSERVATIONS)} on the device cuda",
                hint="Other observations are computed on the CPU: use the device cpu.",
            )
        scene = simulation.scene
        self.scene, self.worlds = scene, simulation.worlds
        self._size = simulation.slots.alive.shape[1]
        self._version, self._reach = shown.version, shown.ray_range_m
        tables = simulation.tables
        self.slots, self.queue = self._moved(simulation.slots), self._moved(simulation.queue)
        self.clock = self._moved(simulation.clock)
        self._walls, self._bodies = self._moved(tables.walls), self._moved(tables.bodies)
        self._free = self._moved(tables.free)
        self._constants = simulation.constants
        shape = (self.worlds, self._size)
        self.observation = self._put(simulation.observation)
        self.nearest = self._put(simulation.nearest)
        self.remaining = self._put(simulation.remaining)
        self.remaining_before = self._put(simulation.remaining_before)
        self.towards = self._put(np.ascontiguousarray(simulation.towards, np.float32))
        self.reward_parts = self._put(np.zeros((*shape, len(PARTS)), np.float32))
        self._beyond = self._put(np.zeros(shape))
        self._own = self._put(np.full(shape, self._version.own_frame))
        self._spare = self._put(np.zeros(shape, np.int32))
        weights = [getattr(reward or Reward(), name) for name in PARTS]
        self._weights = self._put(np.array(weights, np.float64))
        # A person starts on schedule when it is paid first, as with a new `Rewarder`.
        self._paid = self._put(np.full(shape, -1, np.int32))
        self._behind = self._put(np.zeros(shape, np.float32))
        corners, between, sight = tables.routes
        self._sight = self._moved(sight)
        self._routes = tuple(
            self._put(array)
            for array in (
                np.full((*shape, 2), -1, np.int64),  # the wall that hides the goal, next corner
                np.full((*shape, 2), np.nan),  # goal of the path lengths
                np.full((*shape, 5), np.nan),  # line of sight
                np.full((*shape, max(1, len(corners))), np.inf),  # path lengths from corners
                np.ascontiguousarray(corners, np.float64),
                np.ascontiguousarray(corners[:, 0], np.float64),
                np.ascontiguousarray(corners[:, 1], np.float64),
                np.ascontiguousarray(between, np.float64),
            )
        )
        self._cos = self._put(tables.walls.cos.astype(np.float32))
        self._sin = self._put(tables.walls.sin.astype(np.float32))
        self._kernels = _kernels(len(corners))

    def step(self, actions: Any) -> None:
        """Advance every world by one frame; as `Simulation.step`.

        `actions` (W, N, 2) are float32 on the device, of any array with `__cuda_array_interface__`,
        in the frame of the observation.
        """
        numba_s = isinstance(actions, type(self.observation))
        given = actions if numba_s else self._cuda.as_cuda_array(actions)
        threads = min(MOST_THREADS, -(-self._size // WARP) * WARP)
        what = (
            given, self._own, self.slots, self.queue, self.clock, self._constants, self._walls,
            self.remaining, self.remaining_before,
        )  # fmt: skip
        if self._bodies is None:  # a kernel cannot be given None
            self._launch("advance", self.worlds, threads)(*what)
        else:
            self._launch("advance_bodies", self.worlds, threads)(*what, self._bodies, self._spare)

    def observe(self) -> None:
        """Update `observation`, `nearest`, `towards` and `remaining`; as `Simulation.observe`."""
        people = self.worlds * self._size
        blocks = -(-people // THREADS)
        self._launch("route", blocks, THREADS)(
            self.slots, self.towards, self._beyond, *self._routes, self._sight
        )
        results = (self.remaining, self.nearest, self.observation)
        if self._version.rays:
            radius = self.scene.motion.person_radius_m
            self._launch("observe", blocks, THREADS)(
                self.slots, self.towards, self._beyond, self._version.head, self._cos, self._sin,
                self._walls, self._constants, radius, self._reach, *results,
            )  # fmt: skip
        else:
            self._launch("observe_social", blocks, THREADS)(
                self.slots, self.queue, self.clock, self.towards, self._beyond, self._free,
                self._constants, *results,
            )  # fmt: skip

    def pay(self) -> None:
        """Update `reward_parts` (W, N, 8) of everyone who acted in the last step; else zeros."""
        motion, blocks = self.scene.motion, -(-self.worlds * self._size // THREADS)
        self._launch("pay", blocks, THREADS)(
            self.slots, self.queue, self.towards, self.remaining, self.remaining_before,
            self.nearest, self.scene.dt_s, motion.goal_radius_m, 2 * motion.person_radius_m,
            motion.body_radius_m, self._weights, self._paid, self._behind, self.reward_parts,
        )  # fmt: skip

    def _launch(self, name: str, blocks: int, threads: int) -> Any:
        return getattr(self._kernels, name)[blocks, threads, self._stream()]

    def _stream(self) -> Any:
        torch = sys.modules.get("torch")
        if torch is None or not torch.cuda.is_available():
            return 0
        return self._cuda.external_stream(torch.cuda.current_stream().cuda_stream)

    def _put(self, array: np.ndarray) -> Any:
        return self._cuda.to_device(np.ascontiguousarray(array))

    def _moved(self, bundle: Bundle) -> Bundle:
        """A named tuple whose arrays are on the device; None stays None."""
        if bundle is None:
            return bundle
        fields: Sequence[Any] = bundle  # type: ignore[assignment]
        moved = [self._put(of) if isinstance(of, np.ndarray) else of for of in fields]
        return type(bundle)(*moved)
