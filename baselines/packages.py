"""Error messages for baselines whose packages are not installed."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from crowdbench.errors import SettingError, to_install

_PINS = {"imitation": "It pins gymnasium 0.29 and needs a separate environment. "}
"""Why an extra is installed in an environment of its own."""


@contextmanager
def needs(extra: str, module: str) -> Iterator[None]:
    """Context for the imports of the baseline `module` (its `__name__`).

    If the baseline is run as a command, a missing package prints a message and exits with code 2.

    Raises:
        SettingError: a package of the extra is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = SettingError(
            "packages",
            got=f"no {error.name}",
            expected=f"the packages of the extra {extra}",
            hint=_PINS.get(extra, "")
            + to_install(f"{extra},onnx", f".venv-{extra}" if extra in _PINS else ""),
        )
        if module != "__main__":
            raise missing from error
        print(f"crowdbench.baselines: {missing}", file=sys.stderr)
        raise SystemExit(2) from None
