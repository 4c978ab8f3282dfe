"""What is said where a baseline's packages are not installed."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from crowdbench.errors import SettingError

_INSTALL = {
    "imitation": "It pins gymnasium 0.29 and wants an environment of its own. In the clone: "
    "python -m venv .venv-imitation && "
    '.venv-imitation/bin/pip install -c constraints.txt -e ".[imitation,onnx]".',
    "torchrl": 'In the clone: pip install -c constraints.txt -e ".[torchrl,onnx]".',
}


@contextmanager
def needs(extra: str, module: str) -> Iterator[None]:
    """Stands around the imports of the baseline `module` (its `__name__`).

    A baseline that is run as a command prints the message and exits with 2.

    Raises:
        SettingError: a package of the extra is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = SettingError(
            "packages",
            got=f"no {error.name}",
            expected=f"those of the extra {extra}",
            hint=_INSTALL[extra],
        )
        if module != "__main__":
            raise missing from error
        print(f"baselines: {missing}", file=sys.stderr)
        raise SystemExit(2) from None
