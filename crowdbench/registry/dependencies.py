"""What the rollouts of a spawn model or policy depend on."""

from dataclasses import dataclass
from pathlib import Path

from crowdbench import plugins


@dataclass(frozen=True)
class Dependencies:
    """What the rollouts of a spawn model or policy depend on, besides the scene's rules."""

    what: str
    """The model, among those of the same code and files."""
    modules: tuple[str, ...] = ()
    """Modules of crowdbench that it consists of."""
    files: tuple[Path, ...] = ()
    code: bytes = b""
    """A user's code that is in no file."""
    recording: bool = False
    """Whether it plays the scene's recording."""

    @classmethod
    def of_own(cls, kind: plugins.Kind, name: str, *files: Path) -> "Dependencies":
        """Those of a user's class, or of a class of crowdbench that is named like one."""
        module = name.partition(":")[0]
        if module.startswith("crowdbench."):
            return cls(name, (module,), files)
        own, code = plugins.code_of(kind, name)
        return cls(name, (), (*files, *own), code)
