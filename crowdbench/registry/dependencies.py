"""What the rollouts of a spawn model or policy depend on."""

import importlib.util
import inspect
from dataclasses import dataclass
from pathlib import Path

from crowdbench import plugins

_SCORING = ("scene.toml", "anchors.json.gz", "reference.json.gz")
"""Files of a scene that rollouts do not depend on; of `scene.toml` only `Scene.rules` matters."""


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
        own, code = _code_of(kind, name)
        return cls(name, (), (*files, *own), code)


def files_of(folder: Path) -> list[Path]:
    """The files of a scene's folder that a user's class may read, because it is given the scene."""
    return sorted(f for f in folder.iterdir() if f.is_file() and f.name not in _SCORING)


def _code_of(kind: plugins.Kind, name: str) -> tuple[list[Path], bytes]:
    """What a user's part depends on: files, and its pickle if it was defined in a notebook.

    The files are all those in the folder of its module, because weights may be stored there.
    """
    module, colon, _ = name.partition(":")
    if colon:
        found = importlib.util.find_spec(module)
        origin = None if found is None else found.origin
    else:
        import cloudpickle

        own = plugins.part(kind, name)
        of = own if inspect.isclass(own) or inspect.isroutine(own) else type(own)
        try:
            origin = inspect.getfile(of)
        except (TypeError, OSError):
            return [], bytes(cloudpickle.dumps(own))
    if origin is None:
        return [], b""
    return sorted(path for path in Path(origin).parent.iterdir() if path.is_file()), b""
