"""Isolation of a sandbox's child by bubblewrap, where it is installed (Linux).

The child sees the system's programs and libraries, Python, crowdbench, the recordings, and what its
call names; none of the user's other files. It has its own network, process and user namespaces, no
capabilities, and cannot gain any. What it writes outside the folders that its call names is lost.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import crowdbench
from crowdbench.files import home

AS_ROOT = "CROWDBENCH_AS_ROOT"
"""Environment variable that allows submissions to be judged as the user root without bubblewrap."""
_WALLS = (
    "--unshare-user", "--unshare-pid", "--unshare-ipc", "--unshare-uts", "--unshare-net",
    "--die-with-parent", "--cap-drop", "ALL", "--proc", "/proc", "--dev", "/dev", "--tmpfs", "/tmp",
)  # fmt: skip
_SYSTEM = ("/usr", "/etc/ld.so.cache", "/etc/localtime", "/sys/devices/system")
_LINKS = ("/bin", "/sbin", "/lib", "/lib32", "/lib64")
"""Links into /usr on most systems, folders on others."""


@cache
def lacking() -> str:
    """Why children cannot be isolated; empty if they can."""
    if not sys.platform.startswith("linux"):
        return f"{sys.platform} has no bubblewrap"
    if shutil.which("bwrap") is None:
        return "bubblewrap is not installed"
    tried = subprocess.run(
        [*_system(), "--chdir", "/", "true"], capture_output=True, text=True, check=False
    )
    told = tried.stderr.strip().splitlines()
    return f"bubblewrap does not run here ({' '.join(told[:1])})" if tried.returncode else ""


def command(desk: Path, reads: Iterable[Path], writes: Iterable[Path]) -> list[str]:
    """The beginning of the command line of an isolated child.

    It may read `reads`, and write into `desk` and `writes`, which are made if they are missing.
    """
    here = os.getcwd()  # a submission may be named by a relative path
    found = [*_system(), "--dir", here]
    needed = {path.resolve() for path in [*_python(), *reads]}
    for path in sorted(path for path in needed if path.exists()):
        found += ["--ro-bind", str(path), str(path)]
    for copy, place in _machine_code(desk):
        found += ["--bind", str(copy), str(place)]
    for path in (*writes, desk):
        path.mkdir(parents=True, exist_ok=True)
        found += ["--bind", str(path.resolve()), str(path.resolve())]
    return [*found, "--chdir", here]


def _system() -> list[str]:
    found = [shutil.which("bwrap") or "bwrap", *_WALLS]
    for name in _SYSTEM:
        found += ["--ro-bind-try", name, name]
    for path in map(Path, _LINKS):
        if path.is_symlink():
            found += ["--symlink", os.readlink(path), str(path)]
        elif path.exists():
            found += ["--ro-bind", str(path), str(path)]
    return found


def _python() -> list[Path]:
    """Python, its packages, crowdbench, and the recordings."""
    named = (os.environ.get(name, "") for name in ("CROWDBENCH_DATA", "PYTHONPATH"))
    # `python -m` puts the working directory there, which may be the user's home.
    imported = [path for path in sys.path if Path(path).resolve() != Path.cwd()]
    paths = [sys.prefix, sys.base_prefix, *imported, *os.pathsep.join(named).split(os.pathsep)]
    own = [home() / name for name in ("recordings", "prepared", "rollouts")]
    package = Path(crowdbench.__file__).parent
    beside = [package, *(package.parent / name for name in ("scenes", "baselines"))]
    return [*(Path(path) for path in paths if path), *beside, *own]


def _machine_code(desk: Path) -> Sequence[tuple[Path, Path]]:
    """Copies of the folders with compiled kernels: what a child compiles is not used by others."""
    places = {path.parent for path in Path(crowdbench.__file__).parent.rglob("*.nbi")}
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        places.add(Path(named))
    found = []
    for k, place in enumerate(sorted(path.resolve() for path in places if path.is_dir())):
        copy = desk / f"machine-code-{k}"
        shutil.copytree(place, copy, ignore=shutil.ignore_patterns("*.lock", "*.pyc"))
        found.append((copy, place))
    return found
