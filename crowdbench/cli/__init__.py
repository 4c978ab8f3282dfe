"""The command line: a typed function for each command, in one module per group.

A function's signature and docstring are the command's options and help.

Exit codes: 2 after an error of the user (one message), 130 after an interrupt, 143 after SIGTERM,
and 1, without a message, if the reader of the output closes it (`crowdbench … | head`).
"""

from collections.abc import Sequence

from cyclopts import Group

from crowdbench.cli import data, leaderboard, policy, scene, spawn, submit
from crowdbench.cli.evaluate import evaluate, score
from crowdbench.cli.exam import exam
from crowdbench.cli.robots import robots
from crowdbench.cli.running import new_app, run
from crowdbench.cli.version import described_version
from crowdbench.cli.view import record, view

_USE, _MAKE, _PUBLISH = (
    Group(name, sort_key=k)
    for k, name in enumerate(("Use crowds", "Make scenes and models", "Publish results"))
)

app = new_app(
    "crowdbench",
    "A benchmark for crowd simulation with realistic arrivals.",
    version=described_version,
)
for command in (evaluate, exam, robots, score, view, record):
    app.command(command, group=_USE)
for heading, parts in ((_MAKE, (spawn, policy, scene, data)), (_PUBLISH, (submit, leaderboard))):
    for part in parts:
        part.app.group = (heading,)
        app.command(part.app)
app.register_install_completion_command(group="Options")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    return run(app, arguments)
