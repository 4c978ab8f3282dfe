"""What a submission might do in the sandbox."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable

from crowdbench.errors import SettingError

Progress = Callable[[int, int], None]


def add(progress: Progress, a: int, b: int) -> int:
    progress(1, 1)
    time.sleep(0.5)  # until somebody has looked
    return a + b


def hang(progress: Progress) -> None:
    time.sleep(600)


def spin(progress: Progress) -> None:
    while True:
        pass


def crash(progress: Progress) -> None:
    print("about to fall\x1b[31m", flush=True)
    os.abort()


def leave(progress: Progress) -> None:
    os._exit(3)


def fail(progress: Progress) -> None:
    raise ValueError("no such thing")


def refuse(progress: Progress) -> None:
    raise SettingError("the submission", got="nothing", expected="something", mend="Add it.")


def eat(progress: Progress) -> None:
    """Many small pieces, all touched, until there is no more."""
    kept = []
    while True:
        kept.append(b"x" * 2**23)


def eat_together(progress: Progress) -> None:
    """Three processes of 200 MiB each."""
    eaten = "import time; kept = bytearray(200 * 2**20); time.sleep(600)"
    for _ in range(3):
        subprocess.Popen([sys.executable, "-c", eaten])
    time.sleep(600)


def multiply(progress: Progress) -> None:
    for _ in range(40):
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    time.sleep(600)


def outlive(progress: Progress, note: str, hang_s: float) -> None:
    """Leave a child behind that left the session."""
    child = subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True
    )
    with open(note, "w") as file:
        file.write(str(child.pid))
    time.sleep(hang_s)


def write_much(progress: Progress, path: str) -> str:
    try:
        with open(path, "wb") as file:
            for _ in range(64):
                file.write(bytes(2**20))
    except OSError as error:
        return error.strerror or ""
    return "written"


def open_many(progress: Progress) -> int:
    opened = []
    try:
        while True:
            opened.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        for descriptor in opened:
            os.close(descriptor)
        return len(opened)


def reach(progress: Progress, port: int) -> str:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    except OSError as error:
        return str(error.strerror)
    return "reached"


def surroundings(progress: Progress) -> list[str]:
    return sorted(os.environ)
