"""The code that a result depends on, found without running it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import crowdbench
from crowdbench import code
from crowdbench.code import closure, code_hash

REPOSITORY = Path(crowdbench.__file__).parents[1]
Write = Callable[[str, str], None]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """A function that writes a module of a package `crowdbench` of the test's own."""

    def put(module: str, text: str) -> None:
        path = tmp_path.joinpath(*module.split("."))
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        path.write_text(text)
        code._code_hash.cache_clear()
        code._module.cache_clear()
        code._file.cache_clear()

    monkeypatch.setattr(code, "_ROOT", tmp_path)
    (tmp_path / "crowdbench" / "room").mkdir(parents=True)
    put("crowdbench", "__version__ = 1\n")
    put("crowdbench.room", "from crowdbench.room.one import a\nfrom crowdbench.room.two import b\n")
    put("crowdbench.room.one", "a = 1\n")
    put("crowdbench.room.two", "b = 2\n")
    yield put
    code._code_hash.cache_clear()
    code._module.cache_clear()
    code._file.cache_clear()


def test_names_are_followed_through_a_package_to_where_they_are_defined(write: Write) -> None:
    write("crowdbench.user", "from crowdbench.room import b\nfrom crowdbench import __version__\n")
    assert closure(["crowdbench.user"]) == {"crowdbench.user", "crowdbench.room.two"}


def test_a_package_counts_if_it_defines_the_name(write: Write) -> None:
    write("crowdbench.room", "from crowdbench.room.one import a\nboth = a + 1\n")
    write("crowdbench.user", "from crowdbench.room import both\n")
    found = {"crowdbench.user", "crowdbench.room", "crowdbench.room.one"}
    assert closure(["crowdbench.user"]) == found


def test_imports_in_functions_count_and_those_for_types_do_not(write: Write) -> None:
    write(
        "crowdbench.user",
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    from crowdbench.room.one import a\n"
        "def f():\n    from crowdbench.room import two\n"
        "def fit():\n    import crowdbench.room.one\n",
    )
    found = closure(["crowdbench.user"], unused=["crowdbench.*.fit"])
    assert found == {"crowdbench.user", "crowdbench.room.two"}
    assert closure(["crowdbench.user"], cut=["crowdbench.room"]) == {"crowdbench.user"}


BEFORE = '"""One."""\n\ndef f(x):\n    """Two."""\n    return x + 1  # three\n'


@pytest.mark.parametrize(
    ("after", "same"),
    [
        ("def f(x):\n    return (\n        x + 1\n    )\n", True),
        ('def f(x):\n    "Other words."\n    return x + 1\n', True),
        ("def f(x):\n    return x + 2\n", False),
        ("def f(x):\n    return x - 1\n", False),
        ("def f(y):\n    return y + 1\n", False),
        ("def f(x=None):\n    return x + 1\n", False),
        ("def f(x):\n    return x + 1\n\ndef fit(x):\n    return 2\n", True),
        ("def f(x):\n    return x + 1\n\ndef g(x):\n    return 2\n", False),
        ("def f(x):\n    return x + 1\n\nf(1)\n", False),
        ("def f(x):\n    if x:\n        return x + 1\n", False),
    ],
)
def test_words_change_no_hash_and_code_does(write: Write, after: str, same: bool) -> None:
    def found() -> str:
        return code_hash("crowdbench.user", unused=["crowdbench.user.fit"])

    write("crowdbench.user", BEFORE)
    before = found()
    write("crowdbench.user", after)
    assert (found() == before) == same


def test_where_a_statement_stands_counts(write: Write) -> None:
    write("crowdbench.user", "for i in range(3):\n    a = i\n    b = i\n")
    before = code_hash("crowdbench.user")
    write("crowdbench.user", "for i in range(3):\n    a = i\nb = i\n")
    assert code_hash("crowdbench.user") != before


def test_a_change_of_what_is_imported_changes_the_hash(write: Write) -> None:
    write("crowdbench.user", "from crowdbench.room import b\n")
    before = code_hash("crowdbench.user")
    write("crowdbench.room.one", "a = 7\n")
    assert code_hash("crowdbench.user") == before
    write("crowdbench.room.two", "b = 7\n")
    assert code_hash("crowdbench.user") != before


def test_a_folder_that_was_left_over_is_no_package(write: Write, tmp_path: Path) -> None:
    before = code_hash("crowdbench.room.one")
    (tmp_path / "crowdbench" / "room" / "one" / "__pycache__").mkdir(parents=True)
    code._file.cache_clear()
    assert code_hash("crowdbench.room.one") == before


def test_training_scripts_are_found() -> None:
    assert "crowdbench.policies.policy" in closure(["crowdbench.baselines.orca"])


def test_a_module_that_does_not_exist_is_no_root() -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        code_hash("crowdbench.nowhere")


def test_all_modules_can_be_hashed() -> None:
    for package in ("crowdbench", "studies"):
        for path in sorted((REPOSITORY / package).rglob("*.py")):
            parts = path.relative_to(REPOSITORY).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            assert code_hash(name)
