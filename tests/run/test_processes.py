"""A process that is asked to end ends, wherever it is."""

import os
import signal
import subprocess
import sys
import time

import pytest

from crowdbench.run.processes import Stopped, stopping_in_order

CODE = """
import os, signal, time, weakref
from crowdbench.run.processes import stopping_in_order
class Something: pass
something = Something()
watched = weakref.ref(something, lambda _: os.kill(os.getpid(), signal.SIGTERM))
with stopping_in_order():
    del something
    print("goes on", flush=True)
    time.sleep(60)
"""


def test_a_signal_in_the_callback_of_a_weak_reference_ends_the_process() -> None:
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=50)
    assert (done.returncode, done.stdout, done.stderr) == (143, "goes on\n", "")
    assert time.monotonic() - began < 30


def replaced() -> None:
    """As a library in C that replaces what is raised in it."""
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(30)
    except SystemExit:
        raise ValueError("Invalid affine transformation matrix") from None


def test_a_signal_that_a_library_turns_into_an_error_ends_the_process() -> None:
    with pytest.raises(Stopped) as stopped, stopping_in_order():
        replaced()
    assert stopped.value.code == 143


def test_errors_without_a_signal_are_as_they_were() -> None:
    with pytest.raises(ValueError, match="wrong"), stopping_in_order():
        raise ValueError("wrong")


def test_what_others_raise_there_is_told_as_before() -> None:
    other = CODE.replace("os.kill(os.getpid(), signal.SIGTERM)", "1 / 0").replace("60", "0")
    done = subprocess.run([sys.executable, "-c", other], capture_output=True, text=True)
    assert done.returncode == 0
    assert "ZeroDivisionError" in done.stderr
