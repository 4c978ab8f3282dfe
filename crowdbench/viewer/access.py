"""Checks that the viewer can open."""

import os
import socket
import sys
from importlib.util import find_spec

from crowdbench.errors import SettingError, to_install

PORT = 9876
"""Port on which rerun viewers listen."""


def check_rerun() -> None:
    """Raise a `SettingError` if rerun is not installed."""
    if find_spec("rerun") is None:
        hint = to_install("viewer")
        raise SettingError("the viewer", got="no rerun", expected="the package rerun", hint=hint)


def check_screen() -> None:
    """Raise an error if the viewer cannot open.

    Raises:
        SettingError: rerun is not installed, or there is neither a screen nor a running viewer.
    """
    check_rerun()
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and not screen and not listens():
        raise no_screen("no screen")


def no_screen(got: str) -> SettingError:
    """The error that no window of the viewer is there, or can open."""
    return SettingError(
        "the viewer",
        got=got,
        expected="a screen on which its window can open",
        hint="Write a file with `crowdbench view … --save crowd.rrd` and open it with `rerun "
        "crowd.rrd` on a machine with a screen, or start `rerun --serve-web` here first and open "
        "it in a browser.",
    )


def listens() -> bool:
    """Whether a viewer is running, on this machine or at the other end of a tunnel."""
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex(("127.0.0.1", PORT)) == 0
