"""Worlds on a CUDA device are those on the CPU."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cuda_worlds import KINDS
from worlds import Person, simulate, square

from crowdbench.errors import SettingError
from crowdbench.simulation import Settings
from crowdbench.simulation.cuda import CudaSimulation, cuda_module

TESTS = Path(__file__).parents[1]
SIMULATOR = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(TESTS)}


@pytest.mark.long
def test_the_kernels_compute_what_the_cpu_computes_in_the_simulator_of_a_device() -> None:
    done = subprocess.run(
        [sys.executable, TESTS / "cuda_worlds.py"],
        capture_output=True,
        text=True,
        env=os.environ | SIMULATOR,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(KINDS)
    assert [line for line in lines if not line.endswith(": the same bytes")] == []


def test_without_a_device_the_message_says_so() -> None:
    simulation = simulate(square(), Person(), settings=Settings(max_alive=1))
    try:
        cuda_module()
    except SettingError:
        with pytest.raises(SettingError, match=r"device.*cuda.*Or use the device cpu|extra gpu"):
            CudaSimulation(simulation)
    else:
        assert CudaSimulation(simulation).worlds == 1
