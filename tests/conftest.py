"""Shapes are checked wherever crowdbench is used in tests; recordings are found or skipped."""

import atexit
import os
import shutil
import signal
import tempfile
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import pytest
from checked_calls import check_again
from hypothesis import settings

# No deadline: a first call may compile, and how long a test takes is not what it tests.
settings.register_profile("crowdbench", deadline=None, max_examples=50)
settings.load_profile("crowdbench")

# A shell ignores interrupts for its jobs in the background, and programs that tests start and
# interrupt would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


_LOOSE = (
    "crowdbench.envs.config",
    *(f"crowdbench.envs.{name}" for name in ("parallel_env", "person_env", "reference_rewards")),
    *(f"crowdbench.robot.{name}" for name in ("config", "env", "robots", "vector_env")),
    "crowdbench.plugins",
    "crowdbench.baselines",
)


def _checked() -> list[str]:
    """All modules whose functions are checked at each call.

    Left out are modules with compiled kernels, which take no annotations, modules whose tests pass
    arguments of wrong types to see the error messages, and the training scripts, whose numbers may
    be of either kind.
    """
    package = Path(find_spec("crowdbench").origin).parent  # type: ignore[union-attr, arg-type]
    kernels, others = [], []
    for path in package.rglob("*.py"):
        parts = path.relative_to(package.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        code = path.read_text("utf-8")
        left_out = name in _LOOSE or "njit" in code or "crowdbench.compilation" in code
        (kernels if left_out else others).append(name)
    # A package's name stands for all its modules.
    return [n for n in others if not any(k.startswith(f"{n}.") for k in kernels)]


_hook = jaxtyping.install_import_hook(_checked(), "checked_calls.check_first_calls")

# Tests run side by side: threads that wait for work must not keep others from theirs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What the user has imported is not looked at; fixtures of a module share this home.
os.environ["CROWDBENCH_HOME"] = tempfile.mkdtemp(prefix="crowdbench-home-")
atexit.register(shutil.rmtree, os.environ["CROWDBENCH_HOME"], ignore_errors=True)

# Where there is no bubblewrap, as root too: what tests submit is ours.
os.environ.setdefault("CROWDBENCH_AS_ROOT", "1")

REQUIRE_ALL = os.environ.get("CROWDBENCH_REQUIRE_ALL") == "1"


def need(part: object, what: str) -> None:
    """Skip a test whose part is missing; where every part must be there, fail."""
    if not part:
        if REQUIRE_ALL:
            pytest.fail(f"{what} is missing, and CROWDBENCH_REQUIRE_ALL is set")
        pytest.skip(f"{what} is missing")


def need_imitation() -> None:
    """Skip a test, or a whole file of them, of what `imitation` does where it cannot be."""
    _need_extra("imitation", "imitation")


def need_sb3() -> None:
    """The same for what Stable-Baselines3 and sb3-contrib do."""
    _need_extra("sb3", "stable_baselines3", "sb3_contrib")


def _need_extra(extra: str, *packages: str) -> None:
    """Skip where packages are missing which the environment of `imitation` has."""
    if all(map(find_spec, packages)):
        return
    if REQUIRE_ALL and metadata.version("gymnasium").startswith("0."):
        pytest.fail(f"the extra {extra} is missing, and CROWDBENCH_REQUIRE_ALL is set")
    pytest.skip(f"the extra {extra} is missing", allow_module_level=True)


@pytest.fixture(scope="session")
def opentraj() -> Path:
    """The folder of real recordings that CROWDBENCH_DATA names."""
    named = os.environ.get("CROWDBENCH_DATA")
    need(named, "CROWDBENCH_DATA, a folder of recordings in OpenTraj's layout,")
    return Path(str(named)).resolve()


@pytest.fixture(autouse=True)
def checks() -> None:
    """Each test checks the types and shapes in the first calls of each function."""
    check_again()


@pytest.fixture(autouse=True)
def no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is printed is as wide as it needs to be, whatever the tests are run from."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Each test has a CROWDBENCH_HOME of its own."""
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("CROWDBENCH_HOME", str(folder))
    monkeypatch.delenv("CROWDBENCH_MAPS", raising=False)  # studies, once imported, set it
    return folder


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations in this process write no report, which takes longer than their rollouts."""
    monkeypatch.setattr("crowdbench.report.html.write_report", lambda *of, **more: None)


@pytest.fixture
def unadjusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans are not adjusted, which takes longest; `test_plan_calibration` tests that."""
    from crowdbench.spawn.plans.links import Adjustment  # not before annotations are checked

    monkeypatch.setattr("crowdbench.scene_building.fit.adjustment", lambda *of: Adjustment())


@pytest.fixture
def brief_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """New scenes get `ntpp-gmm` of three epochs; `test_ntpp_training` tests what it learns."""
    from crowdbench.spawn.ntpp.training import NtppSettings  # not before annotations are checked

    brief = NtppSettings(epochs=3, patience=1, calibration_points=2000, step_groups=4000)
    monkeypatch.setattr("crowdbench.scene_building.fit.training_settings", lambda *of: brief)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """With `--dist loadgroup` one worker runs all tests of a module that has fixtures of its own.

    Marks do not do: pytest 9.2 takes no other name of a test, by which pytest-xdist 3.8 groups.
    """
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class OfModules(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            path = nodeid.partition("::")[0]
            return path if _has_fixtures(config.rootpath / path) else nodeid

    return OfModules(config, log)


@cache
def _has_fixtures(path: Path) -> bool:
    return 'scope="module"' in path.read_text("utf-8")
