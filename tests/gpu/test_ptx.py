"""The CUDA kernels compile to PTX: their types fit and they allocate nothing. No device is needed.

`make test-gpu` runs this folder in an environment with the extra `gpu`.
"""

from dataclasses import replace
from importlib.util import find_spec
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from msgspec import structs

if not (find_spec("numba_cuda") and find_spec("nvidia")):
    pytest.skip("the extra gpu is missing", allow_module_level=True)

from cuda_worlds import BLOCKS, SIZES, people
from numba import cuda

import crowdbench.simulation.cuda
from crowdbench.simulation import Simulation
from crowdbench.simulation.cuda import CudaSimulation

CAPABILITY = (9, 0)


class OnNoDevice(CudaSimulation):
    """Arrays stay on the CPU, and kernels are compiled, not launched."""

    def __init__(self, simulation: Simulation) -> None:
        self.compiled: dict[str, str] = {}
        super().__init__(simulation)

    def _put(self, array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array)

    def _launch(self, name: str, blocks: int, threads: int) -> object:
        def compiling(*arguments: object) -> None:
            function = getattr(self._kernels, name).py_func
            assert not any(of is None for of in arguments)  # which a launch refuses
            signature = tuple(numba.typeof(of) for of in arguments)
            self.compiled[name], _ = cuda.compile_ptx(function, signature, cc=CAPABILITY)

        return compiling


@pytest.mark.parametrize(
    ("observation", "radius_m"), [("lidar-2", 0.0), ("lidar-3", 0.15), ("social-1", 0.15)]
)
def test_the_kernels_compile(
    observation: str, radius_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not cuda.is_available():
        # What is compiled is not run, so its capability need not be that of a device.
        device = SimpleNamespace(compute_capability=CAPABILITY)
        monkeypatch.setattr(cuda.dispatcher, "get_current_device", lambda: device)
        monkeypatch.setattr(crowdbench.simulation.cuda, "cuda_module", lambda: cuda)
    scene = replace(BLOCKS, motion=structs.replace(BLOCKS.motion, body_radius_m=radius_m))
    simulation = Simulation(scene, worlds=2, settings=replace(SIZES, observation=observation))
    simulation.reset([people(1), people(2)], horizon=20)
    simulation.observe()
    on = OnNoDevice(simulation)
    on.step(np.zeros((2, 8, 2), np.float32))
    on.observe()
    on.pay()
    seeing = "observe_social" if observation == "social-1" else "observe"
    advance = "advance_bodies" if radius_m else "advance"
    assert on.compiled.keys() == {advance, "route", seeing, "pay"}
    assert all(".visible .entry" in ptx for ptx in on.compiled.values())
