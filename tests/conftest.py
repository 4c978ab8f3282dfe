"""Shapes are checked wherever crowdbench is used in tests; recordings are found or skipped."""

import atexit
import os
import shutil
import tempfile
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import pytest
from hypothesis import settings

# No deadline: a first call may compile, and how long a test takes is not what it tests.
settings.register_profile("crowdbench", deadline=None, max_examples=50)
settings.load_profile("crowdbench")

# Compiled kernels take no annotations; everything else is checked at each call.
_hook = jaxtyping.install_import_hook(
    [
        "crowdbench.colours",
        "crowdbench.envs.demonstrations",
        "crowdbench.envs.perturbation",
        "crowdbench.envs.torchrl_env",
        "crowdbench.envs.vec_env",
        "crowdbench.evaluation.evaluate",
        "crowdbench.evaluation.judge",
        "crowdbench.evaluation.replay_check",
        "crowdbench.evaluation.rollout_jobs",
        "crowdbench.files",
        "crowdbench.leaderboard",
        "crowdbench.metrics.arrivals",
        "crowdbench.metrics.forms",
        "crowdbench.metrics.interaction",
        "crowdbench.metrics.lattice",
        "crowdbench.metrics.lives",
        "crowdbench.metrics.metric",
        "crowdbench.metrics.motion",
        "crowdbench.metrics.presence",
        "crowdbench.metrics.rows",
        "crowdbench.metrics.space",
        "crowdbench.policies.card",
        "crowdbench.policies.export",
        "crowdbench.policies.network",
        "crowdbench.policies.policy",
        "crowdbench.policies.walkers",
        "crowdbench.recordings",
        "crowdbench.registry",
        "crowdbench.report.display_names",
        "crowdbench.report.html",
        "crowdbench.report.plots",
        "crowdbench.rollouts.episode",
        "crowdbench.rollouts.rollout",
        "crowdbench.report.text",
        "crowdbench.scene",
        "crowdbench.scene_building",
        "crowdbench.scoring.reference",
        "crowdbench.simulation.reward",
        "crowdbench.simulation.simulation",
        "crowdbench.spawn.areas",
        "crowdbench.spawn.block_replay",
        "crowdbench.spawn.events",
        "crowdbench.spawn.groups",
        "crowdbench.spawn.model",
        "crowdbench.spawn.ntpp",
        "crowdbench.spawn.ntpp_likelihood",
        "crowdbench.spawn.ntpp_sequences",
        "crowdbench.spawn.ntpp_training",
        "crowdbench.spawn.poisson",
        "crowdbench.spawn.renewal",
        "crowdbench.spawn.replay",
        "crowdbench.spawn.rescaling",
        "crowdbench.spawn.scenario",
        "crowdbench.spawn.steered",
        "crowdbench.spawn.weights",
        "crowdbench.studies.ablation",
        "crowdbench.studies.gallery",
        "crowdbench.studies.results",
        "crowdbench.studies.steering",
        "crowdbench.studies.walks",
        "crowdbench.trajectories.blocks",
        "crowdbench.trajectories.storage",
        "crowdbench.trajectories.table",
        "crowdbench.viewer",
    ],
    "beartype.beartype",
)

# Tests run side by side: threads that wait for work must not keep others from theirs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What the user has imported is not looked at; fixtures of a module share this home.
os.environ["CROWDBENCH_HOME"] = tempfile.mkdtemp(prefix="crowdbench-home-")
atexit.register(shutil.rmtree, os.environ["CROWDBENCH_HOME"], ignore_errors=True)

REQUIRE_ALL = os.environ.get("CROWDBENCH_REQUIRE_ALL") == "1"


def need(part: object, what: str) -> None:
    """Skip a test whose part is missing; where every part must be there, fail."""
    if not part:
        if REQUIRE_ALL:
            pytest.fail(f"{what} is missing, and CROWDBENCH_REQUIRE_ALL is set")
        pytest.skip(f"{what} is missing")


def need_imitation() -> None:
    """Skip a test, or a whole file of them, of what `imitation` does where it cannot be."""
    if find_spec("imitation"):
        return
    if REQUIRE_ALL and metadata.version("gymnasium").startswith("0."):
        pytest.fail("the extra imitation is missing, and CROWDBENCH_REQUIRE_ALL is set")
    pytest.skip("imitation is missing; it needs gymnasium 0.29", allow_module_level=True)


@pytest.fixture(scope="session")
def opentraj() -> Path:
    """The folder of real recordings that CROWDBENCH_DATA names."""
    named = os.environ.get("CROWDBENCH_DATA")
    need(named, "CROWDBENCH_DATA, a folder of recordings in OpenTraj's layout,")
    return Path(str(named)).resolve()


@pytest.fixture(autouse=True)
def no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is printed is as wide as it needs to be, whatever the tests are run from."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Each test has a CROWDBENCH_HOME of its own."""
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("CROWDBENCH_HOME", str(folder))
    return folder
