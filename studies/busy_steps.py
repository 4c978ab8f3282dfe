"""How long steps take beside four busy processes, and beside them on one thread that never spins.

    python -m studies busy-steps

280 steps of a `CrowdEnv` of 16 worlds, whatever was imported before it: each first as it is, then
with `NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OMP_WAIT_POLICY=PASSIVE`. The ratio is to be below 3.
"""

import os
import statistics
import subprocess
import sys
from collections.abc import Iterator

BUSY = 4
STEPS = 280
TIMES = 5
BEFORE = {
    "crowdbench first": "",
    "torch first": "import torch; torch.rand(2_000_000).exp().sum()",
    "scikit-learn first": (
        "import numpy as np; from sklearn.cluster import KMeans; "
        "KMeans(3, n_init=1).fit(np.random.rand(5000, 3))"
    ),
    "numba first": (
        "import numba, numpy as np\n"
        "@numba.njit(parallel=True)\n"
        "def f(x):\n"
        "    for i in numba.prange(len(x)):\n"
        "        x[i] += 1\n"
        "f(np.zeros(1_000_000))"
    ),
}
CALM = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
STEP = f"""
import time
from crowdbench.envs.torchrl_env import CrowdEnv
env = CrowdEnv("eth-v0", worlds=16, horizon_s=120.0, seed=0)
for _ in range({TIMES} + 1):
    state = env.reset()
    began = time.perf_counter()
    for _ in range({STEPS}):
        state["agents", "action"] = 0.3 * state["agents", "observation"][..., 3:5]
        state = env.step(state)["next"]
    print(time.perf_counter() - began, flush=True)
"""


def took_s(before: str, environment: dict[str, str]) -> float:
    """Median of the seconds that so many steps take, after a first time that compiles."""
    plain = {name: value for name, value in os.environ.items() if name not in CALM}
    done = subprocess.run(
        [sys.executable, "-c", before + STEP],
        env=plain | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return statistics.median(float(line) for line in done.stdout.split()[1:])


def times() -> Iterator[str]:
    """A line with the times for each order of imports."""
    loop = "while True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", loop]) for _ in range(BUSY)]
    try:
        for name, before in BEFORE.items():
            plain, calm = took_s(before, {}), took_s(before, CALM)
            yield f"{name:20}{plain:7.2f} s {calm:7.2f} s  ratio {plain / calm:.2f}"
    finally:
        for process in busy:
            process.kill()
