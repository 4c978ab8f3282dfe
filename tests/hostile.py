"""What a submission might do in the sandbox."""

import json
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.progress import ROLLOUTS


def add(a: int, b: int) -> int:
    ROLLOUTS(1, 1)
    time.sleep(0.5)  # until somebody has looked
    return a + b


def hang() -> None:
    time.sleep(600)


def hang_by_name(note: str) -> None:
    Path(f"{note}.half").write_text(str(os.getpid()))
    Path(f"{note}.half").rename(note)
    time.sleep(600)


def spin() -> None:
    while True:
        pass


def crash() -> None:
    print("about to fall\x1b[31m", flush=True)
    os.abort()


def leave() -> None:
    os._exit(3)


def fail() -> None:
    raise ValueError("no such thing")


def refuse() -> None:
    raise SettingError("the submission", got="nothing", expected="something", hint="Add it.")


def eat() -> None:
    """Many small pieces, all touched, until there is no more."""
    kept = []
    while True:
        kept.append(b"x" * 2**23)


def eat_together() -> None:
    """Three processes of 200 MiB each."""
    eaten = "import time; kept = bytearray(200 * 2**20); time.sleep(600)"
    for _ in range(3):
        subprocess.Popen([sys.executable, "-c", eaten])
    time.sleep(600)


def multiply() -> None:
    for _ in range(40):
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    time.sleep(600)


def outlive(note: str, hang_s: float) -> None:
    """Leave a child behind that left the session."""
    child = subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True
    )
    with open(note, "w") as file:
        file.write(str(child.pid))
    time.sleep(hang_s)


def pipe_for_answer() -> None:
    """Who opens it to read waits until somebody writes."""
    os.mkfifo(Path(sys.argv[1], "answer.json"))
    os._exit(0)


def pipe_for_progress() -> None:
    os.mkfifo(Path(sys.argv[1], "progress"))
    time.sleep(600)


def endless_progress() -> None:
    Path(sys.argv[1], "progress").symlink_to("/dev/zero")
    time.sleep(600)


def linked_answer(to: str) -> None:
    Path(sys.argv[1], "answer.json").symlink_to(to)
    os._exit(0)


def nested_answer() -> None:
    Path(sys.argv[1], "answer.json").write_text('{"network":"none","value":' + "[" * 10**6)
    os._exit(0)


def pipe_for_what_it_says() -> None:
    said = Path(sys.argv[1], "said.txt")
    said.unlink(missing_ok=True)
    os.mkfifo(said)
    os._exit(3)


def paint() -> None:
    """A message that would clear a terminal and speak to what reads its lines."""
    raise SettingError("\x1b[2J", got="a\n::warning::b", expected="c", hint="d" * 10_000)


def refuse_submission() -> None:
    from crowdbench.leaderboard.submission.errors import SubmissionError  # which is heavy

    problems = [SettingError(f"file {k}", got="x", expected="y", hint="Mend.") for k in range(2)]
    raise SubmissionError("mine", problems)


def write_much(path: str) -> str:
    try:
        with open(path, "wb") as file:
            for _ in range(64):
                file.write(bytes(2**20))
    except OSError as error:
        return error.strerror or ""
    return "written"


def open_many() -> int:
    opened = []
    try:
        while True:
            opened.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        for descriptor in opened:
            os.close(descriptor)
        return len(opened)


def reach(port: int) -> str:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    except OSError as error:
        return str(error.strerror)
    return "reached"


def surroundings() -> list[str]:
    return sorted(os.environ)


def keep_in_the_store(key: str, beside: str) -> str:
    """What the store has for a key, after this has tried to add to it."""
    from crowdbench.run import store

    store.keep(key, ".parquet", b"hostile", Path(beside))
    found = store.find(key, ".parquet", Path("elsewhere"))
    return "" if found is None else found.read_text()


def look(path: str, home: str) -> dict[str, object]:
    """What it finds of a secret file, of the user's home, and of the process that started it."""
    try:
        secret = Path(path).read_text()
    except OSError as error:
        secret = error.strerror or ""
    inside = sorted(name for name in os.listdir(home)) if Path(home).is_dir() else []
    known = {part for entry in (sys.prefix, sys.base_prefix) for part in Path(entry).parts}
    try:
        os.kill(json.loads(Path(sys.argv[1], "asked.json").read_text())["parent"] or 2**22 - 1, 0)
        signal = "reached"
    except OSError:
        signal = "no process"
    return {"secret": secret, "home": [i for i in inside if i not in known], "signal": signal}


def write_into(folders: list[str]) -> None:
    for folder in folders:
        with suppress(OSError):
            Path(folder).mkdir(parents=True, exist_ok=True)
            Path(folder, "file").write_text("written")


def fork_twice(path: str) -> None:
    """Leave a grandchild behind that left the session and writes on."""
    beat = f"""
import pathlib, time
for k in range(600):
    pathlib.Path({path!r}).write_text(str(k))
    time.sleep(.05)
"""
    if os.fork() == 0:
        os.setsid()
        subprocess.Popen([sys.executable, "-c", beat])
        os._exit(0)
    time.sleep(2)
