"""What a result depends on in crowdbench's own code: modules without comments and docstrings.

`code_hash` follows the imports of modules from their source, without importing them. It is part of
the fingerprint of everything that is kept: rollouts, prepared recordings, fits and pages.
"""

import ast
import hashlib
from collections.abc import Collection, Iterable, Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import NamedTuple

DECIDE_NOTHING = tuple(
    f"crowdbench.{name}"
    for name in (
        *("cli", "code", "envs.registration", "errors", "files", "plugins", "progress"),
        *("run.executor", "run.processes", "run.ray_executor", "run.store"),
    )
)
"""Modules whose code changes no result: messages, names for other libraries, reading and writing,
finding code of others, which is hashed itself, and where something is computed."""
_ROOT = Path(__file__).parents[1]  # the folder of the package, and of `studies` in a clone
_OURS = ("crowdbench", "studies")
_SCRIPTS = "crowdbench.baselines."


class _Module(NamedTuple):
    digest: str
    imports: tuple[tuple[str, str], ...]
    """Module and name, as in `from module import name`; the name is empty in `import module`."""


class _OnlyWhatRuns(ast.NodeTransformer):
    """Removes functions that are never called, and what types alone need."""

    def __init__(self, module: str, unused: Collection[str]) -> None:
        self.module, self.unused = module, unused

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST | None:
        name = f"{self.module}.{node.name}"
        return None if any(fnmatchcase(name, p) for p in self.unused) else self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        return node.orelse if ast.unparse(node.test).endswith("TYPE_CHECKING") else node


def code_hash(*roots: str, cut: Collection[str] = (), unused: Collection[str] = ()) -> str:
    """Hash of the code of modules and of all that they import, see `closure`.

    Comments, docstrings and the layout of the code are left out, so that changing them changes no
    hash, and so are fields of the syntax that only newer versions of Python have.

    Args:
        roots: full names of modules, such as `crowdbench.run.rollout`.
        cut: modules, or packages with all that is in them, whose imports are not followed.
        unused: functions that are left out, as `module.name`, or `package.*.name` for all modules
            in a package: they are never called for this result.
    """
    return _code_hash(roots, tuple(cut), tuple(unused))


@cache
def _code_hash(roots: tuple[str, ...], cut: tuple[str, ...], unused: tuple[str, ...]) -> str:
    each = sorted(closure(roots, cut=cut, unused=unused))
    digests = [f"{name} {_module(name, unused).digest}" for name in each]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()[:16]


def closure(
    roots: Iterable[str], *, cut: Collection[str] = (), unused: Collection[str] = ()
) -> set[str]:
    """Full names of modules and of all modules of ours that they import, directly or not.

    Imports in functions count, those for types alone do not. Of a package's `__init__`, only the
    names that are imported from it are followed: to the modules that define them. See `code_hash`
    for the arguments.
    """
    found: set[str] = set()
    todo = list(roots)
    left = (*cut, *DECIDE_NOTHING)
    while todo:
        name = todo.pop()
        if name in found:
            continue
        found.add(name)
        wanted = (_defined_in(*each) for each in _module(name, tuple(unused)).imports)
        todo += [m for m in wanted if m and not any(f"{m}.".startswith(f"{of}.") for of in left)]
    return found


def _defined_in(module: str, name: str) -> str | None:
    """The module that defines a name which another imports from `module`; None if it is not ours.

    What the package `crowdbench` itself offers is found on first use, and not followed.
    """
    if module.split(".")[0] not in _OURS:
        return None
    if name and _file(f"{module}.{name}").exists():
        return f"{module}.{name}"
    if module == "crowdbench" or not _file(module).exists():
        return None
    if name and _file(module).stem == "__init__":
        for other, passed in _module(module).imports:
            if passed == name:
                return _defined_in(other, name)
    return module


@cache
def _file(module: str) -> Path:
    path = _ROOT.joinpath(*module.split("."))
    if module.startswith(_SCRIPTS) and not path.with_suffix(".py").exists():  # of a clone
        path = _ROOT.joinpath(*module.split(".")[1:])
    package = path / "__init__.py"  # a folder alone may be left over from a former version
    return package if package.exists() else path.with_suffix(".py")


@cache
def _module(module: str, unused: tuple[str, ...] = ()) -> _Module:
    tree = _OnlyWhatRuns(module, unused).visit(ast.parse(_file(module).read_bytes()))
    imports: dict[tuple[str, str], None] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= dict.fromkeys((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            imports |= dict.fromkeys((node.module or "", alias.name) for alias in node.names)
    digest = hashlib.sha256("\n".join(_words(tree)).encode()).hexdigest()
    return _Module(digest, tuple(imports))


def _words(value: object) -> Iterator[str]:
    """The abstract syntax as words; empty fields differ between versions of Python, and go."""
    if isinstance(value, ast.AST):
        yield type(value).__name__
        for name, field in ast.iter_fields(value):
            if field is not None and field != [] and name not in ("ctx", "kind", "type_comment"):
                yield name
                yield from _words(field)
    elif isinstance(value, list):
        for each in value:
            if not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)):
                yield from _words(each)
        yield "end"
    else:
        yield repr(value)
