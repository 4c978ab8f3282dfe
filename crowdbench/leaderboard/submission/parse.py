"""Read `submission.toml`, and report all its problems at once."""

import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec

from crowdbench.errors import did_you_mean
from crowdbench.leaderboard.submission.errors import Problems, RefusedError
from crowdbench.leaderboard.submission.limits import LARGEST_DECLARATION, MOST_DOTS
from crowdbench.leaderboard.submission.schema import FILE, Declared, Trained
from crowdbench.registry import SPAWN_MODELS
from crowdbench.scene import list_scenes

PLACEHOLDER = "FILL IN"
"""Begins each value of the template that the author must replace."""
_LINE = "1 to 200 printable characters on one line"
_EXPECTED = {
    "schema": "1",
    "name": _LINE,
    "authors": f'a list of 1 to 50 names such as ["Ada Lovelace"], each {_LINE}',
    "contact": f"an e-mail address or an issue tracker, as {_LINE}",
    "link": "a complete URL that begins with https://, in ASCII characters and without spaces",
    "date": 'the day of the submission in quotes, such as "2026-11-29"',
    "licence": "an SPDX identifier such as Apache-2.0 or CC-BY-4.0, see https://spdx.org/licenses",
    "track": "walk, spawn or crowd",
    "kind": "learned, model-based or privileged",
    "scenes": "a list of different scenes, from {scenes}",
    "training": "a table [training] with data, protocol and parameters",
    "training.data": "1 to 1000 printable characters on one line",
    "training.protocol": "heldout, none or full",
    "training.parameters": "an integer from 0 to 10^12, without quotes",
    "shipped_policy": "the name of a policy that comes with crowdbench, or no such field",
    "shipped_spawn": f"one of {', '.join(SPAWN_MODELS)}, or no such field",
}
_UNSEEN = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0100-\U000e01ef]"
)
"""Printable but invisible characters: fillers, blanks and variation selectors."""
_CLAIMS = re.compile(r"\b(official|verified|certified|ranked)\b", re.IGNORECASE)
"""Words by which a name would claim to be what only verification can say."""
_MOST_MARKS = 4  # combining marks on one letter; more of them would overlap the lines above
# They replace invalid fields that are only displayed, so that the artefacts are checked as well.
_STAND_INS = {
    "name": "?",
    "authors": ["?"],
    "contact": "?",
    "link": "https://example.org",
    "date": "",
    "licence": "MIT",
    "kind": "learned",
    "training.data": "?",
    "training.parameters": 0,
}


def read_declared(path: Path, problems: Problems) -> Declared | None:
    """Return what a submission declares, and append all problems with it to `problems`.

    An invalid field that is only displayed gets a stand-in value. If a field that the checks of the
    artefacts depend on is invalid, None is returned.
    """
    raw = _raw(path, problems)
    if raw is None:
        return None
    training = raw.get("training")
    trained = training if isinstance(training, dict) else {}
    wrong = list(_wrong_fields(Declared, raw))
    if trained is training:
        wrong += _wrong_fields(Trained, trained, "training.")
    problems += wrong
    names = {refusal.where.partition(", ")[2] for refusal in wrong}
    usable = _usable(Declared, raw, names)
    usable["training"] = _usable(Trained, trained, names, "training.")
    try:
        return msgspec.convert(usable, Declared)
    except msgspec.ValidationError:
        return None


def _usable(
    kind: type[msgspec.Struct], raw: Mapping[str, Any], wrong: set[str], prefix: str = ""
) -> dict[str, Any]:
    """The valid fields, and stand-ins for others that are only displayed."""
    names = [field.name for field in msgspec.structs.fields(kind)]
    valid = {name: raw[name] for name in names if name in raw and prefix + name not in wrong}
    return {n: _STAND_INS[prefix + n] for n in names if prefix + n in _STAND_INS} | valid


def _raw(path: Path, problems: Problems) -> dict[str, Any] | None:
    try:
        if path.stat().st_size > LARGEST_DECLARATION:
            got, expected = f"{path.stat().st_size} bytes", f"at most {LARGEST_DECLARATION}"
        elif (dots := (text := path.read_text(encoding="utf-8")).count(".")) > MOST_DOTS:
            got, expected = f"{dots} dots", f"at most {MOST_DOTS}"
        else:
            return tomllib.loads(text)
    except OSError as error:
        got, expected = error.strerror or "no file", "a readable file"
    except (ValueError, RecursionError) as error:  # not UTF-8 or TOML, or numbers of 5000 digits
        got, expected = str(error), "valid TOML in UTF-8"
    hint = "Compare it with the file that `crowdbench submit init` writes; strings need quotes."
    problems.refuse(FILE, got=got, expected=expected, hint=hint)
    return None


def _wrong_fields(
    kind: type[msgspec.Struct], raw: Mapping[str, Any], prefix: str = ""
) -> Iterator[RefusedError]:
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for name in raw:
        if name not in fields:
            yield RefusedError(
                f"{FILE}, {prefix}{ascii(name)[1:-1][:60]}",
                got="an unknown field",
                expected=f"only {', '.join(fields)}",
                hint=did_you_mean(name, fields) or "Remove or rename it.",
            )
    for name, field in fields.items():
        if name in raw:
            hint = _hint(prefix + name, raw[name], field.type)
        elif field.required:
            hint = "Add it."
        else:
            continue
        if hint is not None:
            got = _brief(raw[name]) if name in raw else "no such field"
            expected = _EXPECTED[prefix + name].format(scenes=", ".join(list_scenes()))
            yield RefusedError(f"{FILE}, {prefix}{name}", got=got, expected=expected, hint=hint)


def _hint(name: str, value: Any, kind: Any) -> str | None:
    """The hint for an invalid value (empty where `expected` says enough); None if it is valid."""
    texts = [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, str)]
    if any(text.startswith(PLACEHOLDER) for text in texts):
        return "Replace the template's placeholder."
    if name == "training":
        return None if isinstance(value, dict) else "Write its fields below a line [training]."
    try:
        msgspec.convert(value, kind, strict=True)
    except ValueError:  # from msgspec, or from Python for numbers of 5000 digits
        return ""  # `expected` says enough
    for text in texts:
        if not text.isprintable():
            return "Remove control characters and characters that change the text direction."
        if _UNSEEN.search(text) or _most_marks(text) > _MOST_MARKS:
            return "Remove invisible characters and stacked combining marks."
        if not text.strip() and not name.startswith("shipped_"):
            return "Enter a text that is not blank."
        if name == "name" and (alike := _look_alikes(text)):
            return (
                f"Replace {alike[0]!r} ({unicodedata.name(alike[0], 'no letter')}), which looks "
                "like an ASCII letter or digit."
            )
        if name == "name" and (claim := _CLAIMS.search(text)):
            return f"Leave out “{claim[0]}”: only the leaderboard says what an entry is."
    if name == "scenes" and (set(value) - set(list_scenes()) or len(set(value)) < len(value)):
        return "`crowdbench scene list` lists all scenes."
    if name == "shipped_spawn" and value not in ("", *SPAWN_MODELS):
        return "Contribute a new family of spawn models with its code, in a pull request."
    return None


def _look_alikes(text: str) -> list[str]:
    """The characters of a text that look like an ASCII letter or digit, but are none."""
    from confusable_homoglyphs import confusables

    others = [c for c in text if not c.isascii()]
    found = confusables.is_confusable("".join(others), greedy=True, preferred_aliases=[]) or []
    return [
        each["character"]
        for each in found
        if any(like["c"].isascii() and like["c"].isalnum() for like in each["homoglyphs"])
    ]


def _most_marks(text: str) -> int:
    marks = [unicodedata.category(c) in ("Mn", "Me") for c in text]
    return max((len(list(run)) for of_marks, run in groupby(marks) if of_marks), default=0)


def _brief(value: Any) -> str:
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a hexadecimal number of more than 4300 decimal digits
        return "a value that is too long to print"
    return text if len(text) <= 80 else f"{text[:60]}… ({len(text)} characters)"
