"""Checks that rerun is available, and recording streams to it."""

import os
import socket
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

from crowdbench.errors import SettingError, to_install
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

PORT = 9876
"""Port on which rerun viewers listen."""


def new_stream(scene: Scene, title: str) -> "RecordingStream":
    """A stream for one recording in the viewer; the viewer keeps a layout per scene."""
    import rerun as rr

    stream = rr.RecordingStream(f"crowdbench {scene.id}")
    stream.send_recording_name(title)
    return stream


def open_stream(scene: Scene, title: str, first_look: "Blueprint") -> "RecordingStream":
    """A stream to the viewer that is open, or to a new window.

    Raises:
        SettingError: as `check_screen`, or the window did not open.
    """
    check_screen()
    stream = new_stream(scene, title)
    stream.spawn(port=PORT, connect=False)
    if not _listens():
        raise _no_screen("a window that did not open")
    address = f"rerun+http://127.0.0.1:{PORT}/proxy"
    stream.connect_grpc(address, default_blueprint=first_look)
    return stream


def check_rerun() -> None:
    """Raise an error if rerun is not installed.

    Raises:
        SettingError: rerun is not installed.
    """
    if find_spec("rerun") is None:
        raise SettingError(
            "the viewer",
            got="no rerun",
            expected="the package rerun",
            hint=to_install("viewer"),
        )


def check_screen() -> None:
    """Raise an error if the viewer cannot open.

    Raises:
        SettingError: rerun is not installed, or there is neither a screen nor a running viewer.
    """
    check_rerun()
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and not screen and not _listens():
        raise _no_screen("no screen")


def _no_screen(got: str) -> SettingError:
    return SettingError(
        "the viewer",
        got=got,
        expected="a screen on which its window can open",
        hint="Write a file with `crowdbench view … --save crowd.rrd` and open it with `rerun "
        "crowd.rrd` on a machine with a screen, or start `rerun --serve-web` here first and open "
        "it in a browser.",
    )


def _listens() -> bool:
    """Whether a viewer is running, on this machine or at the other end of a tunnel."""
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex(("127.0.0.1", PORT)) == 0
