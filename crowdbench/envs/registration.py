"""Ids of the environments for `gymnasium.make` and `pettingzoo.make`.

Neither library looks for ids in the packages that are installed (gymnasium did before 1.0), so
`import crowdbench` registers them: at once in a library that has been imported before, and in
another one when it is imported. It imports neither of them, because that takes longer than
everything else that it does.
"""

import sys
from collections.abc import Callable, Iterator
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_SINGLE_AGENT: dict[str, dict[str, str]] = {
    "": {"entry_point": "crowdbench.envs.person_env:PersonEnv"},
    "Robot-": {
        "entry_point": "crowdbench.robot.env:RobotEnv",
        "vector_entry_point": "crowdbench.robot.vector_env:RobotVectorEnv",
    },
}
"""What gymnasium makes: the prefix of the scene in the id, and the places of the classes."""
_MULTI_AGENT = {
    "parallel": "crowdbench.envs.parallel_env:parallel_env",
    "aec": "crowdbench.envs.parallel_env:aec_env",
}
"""What PettingZoo makes: the type of the environment, and the place of the function."""


def register_on_import() -> None:
    """Register in the libraries that have been imported, and in others at their import."""
    for name, register in _REGISTER.items():
        if name in sys.modules:
            register(sys.modules[name])
    if not any(isinstance(finder, _Watcher) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watcher())


def _scenes() -> Iterator[tuple[str, dict[str, Any]]]:
    """The id of each scene, and the arguments with which its environments are made."""
    from crowdbench.scene import list_scenes

    for scene in list_scenes():
        yield scene, {"scene": scene}


def _register_in_gymnasium(gymnasium: ModuleType) -> None:
    for scene, arguments in _scenes():
        for prefix, places in _SINGLE_AGENT.items():
            known = f"crowdbench/{prefix}{scene}"
            if known not in gymnasium.registry:
                gymnasium.register(known, kwargs=arguments, **places)


def _register_in_pettingzoo(pettingzoo: ModuleType) -> None:
    if not hasattr(pettingzoo, "register"):  # PettingZoo has it from 1.27 on
        return
    for scene, arguments in _scenes():
        for kind, place in _MULTI_AGENT.items():
            known = f"crowdbench/{scene}"
            if known not in getattr(pettingzoo, f"{kind}_registry"):
                pettingzoo.register(kind, known, entry_point=place, kwargs=arguments)


_REGISTER: dict[str, Callable[[ModuleType], None]] = {
    "gymnasium": _register_in_gymnasium,
    "pettingzoo": _register_in_pettingzoo,
}


class _Watcher(MetaPathFinder):
    """Finds nothing itself, but lets the import of a library end with the registration."""

    def find_spec(
        self, fullname: str, path: Any, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname not in _REGISTER:
            return None
        for finder in sys.meta_path:
            find = getattr(finder, "find_spec", None)  # finders of old libraries have none
            spec = None if finder is self or find is None else find(fullname, path, target)
            if spec is not None:
                if spec.loader is not None:
                    spec.loader = _Registering(spec.loader)
                return spec
        return None


class _Registering(Loader):
    """Loads a library as its own loader does, and then registers in it."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        # What reads resources or sources of the library later asks its own loader.
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        _REGISTER[module.__name__](module)
