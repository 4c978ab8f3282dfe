"""The errors a user can cause.

Each says where it happened, what was got, what was expected and how to mend it; the command
line prints that message and exits with code 2.
"""


class CrowdbenchError(Exception):
    """Base of every error that bad input or a bad setting causes."""

    def __init__(self, where: object, *, got: str, expected: str, hint: str = "") -> None:
        self.where = str(where)
        self.got = got
        self.expected = expected
        self.hint = hint
        message = f"{self.where}: got {got}; expected {expected}."
        super().__init__(f"{message} {hint}".rstrip())

    def __reduce__(self) -> tuple[object, ...]:
        # Errors travel between worker processes, and keyword arguments do not pickle by default.
        return _rebuild, (type(self), self.where, self.got, self.expected, self.hint)


def _rebuild(
    kind: type[CrowdbenchError], where: str, got: str, expected: str, hint: str
) -> CrowdbenchError:
    return kind(where, got=got, expected=expected, hint=hint)


class RecordingError(CrowdbenchError):
    """A recording or a table of trajectories that cannot be read or does not fit."""


class FetchError(CrowdbenchError):
    """A published recording that cannot be fetched."""


class SceneError(CrowdbenchError):
    """A scene that is unknown or whose files are broken."""


class WeightsError(CrowdbenchError):
    """Fitted weights that are missing, broken, or belong to something else."""


class OutputError(CrowdbenchError):
    """A place that cannot be written to."""


class SettingError(CrowdbenchError):
    """A name, a number or an option that does not exist or is out of range."""


class WorkerError(CrowdbenchError):
    """A process that died before its work was done."""


class OwnCodeError(CrowdbenchError):
    """A class of the user's own that raised an error of another kind."""


class ActionError(CrowdbenchError):
    """Actions that do not fit the agents that are there."""


class CapacityError(CrowdbenchError):
    """More persons than the environment has slots or ids for."""
