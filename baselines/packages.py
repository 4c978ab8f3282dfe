"""Error messages for baselines whose packages are not installed."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from crowdbench.errors import SettingError

_INSTALL = {
    "imitation": "It pins gymnasium 0.29 and needs a separate environment. Run in the clone: "
    "python -m venv .venv-imitation && "
    '.venv-imitation/bin/pip install -c constraints.txt -e ".[imitation,onnx]".',
    "fit": 'Run in the clone: pip install -c constraints.txt -e ".[fit,onnx]".',
    "torchrl": 'Run in the clone: pip install -c constraints.txt -e ".[torchrl,onnx]".',
}


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
            hint=_INSTALL[extra],
        )
        if module != "__main__":
            raise missing from error
        print(f"crowdbench.baselines: {missing}", file=sys.stderr)
        raise SystemExit(2) from None
