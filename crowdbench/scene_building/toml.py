"""`scene.toml` of a new scene, with the rules behind its numbers as comments."""

import json

import msgspec

from crowdbench.scene import SCHEMA, Scene

_HEAD = """\
# {title}. Made by `crowdbench scene create` from {source}.
# Change a number here, then run `crowdbench fit`, `crowdbench power --write` and
# `crowdbench anchors` on this folder; `crowdbench scene check` tells what does not fit.
"""
_WHY = {
    "bounds": "The recorded extent and half a metre more. Who walks out has left.",
    "walls": "Of {walls}, as far as they stand within the bounds.",
    "motion": "A goal is reached within half of a typical step.",
    "spawning": "As in the scenes that come with crowdbench.",
    "clustering.default": "The smallest radius of a ladder with which DBSCAN leaves out less than "
    "10 % of\n# starts, and of ends.",
    "protocol": "Time blocks by the length of the recording; `crowdbench power` finds what is "
    "scored.",
}


def scene_toml(scene: Scene, *, source: str, walls_file: str) -> str:
    """The text of the file, its tables in the order of the shipped scenes."""
    whole = {name: getattr(scene, name) for name in ("id", "title", "dt_s", "grid_s")}
    lines = [
        _HEAD.format(title=_one_line(scene.title), source=_one_line(source)).rstrip("\n"),
        *_fields({"schema": SCHEMA, **whole}),
        *_table("recording", scene.recording),
        *_table("bounds", scene.bounds),
        "",
    ]
    if scene.walls:
        lines += ["# " + _WHY["walls"].format(walls=_one_line(walls_file))]
    for wall in scene.walls:
        lines += ["[[walls]]", *_fields(msgspec.structs.asdict(wall)), ""]
    for name in ("motion", "spawning", "clustering.default", "protocol"):
        table, _, entry = name.partition(".")
        values = getattr(scene, table)
        lines += [*_table(name, values[entry] if entry else values)[1:], ""]
    return "\n".join(lines)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _table(name: str, values: msgspec.Struct) -> list[str]:
    why = ["# " + _WHY[name]] if name in _WHY else []
    known = msgspec.structs.asdict(values)
    known.pop("scored", None)  # the power study writes it at the end
    return ["", *why, f"[{name}]", *_fields(known)]


def _fields(values: dict[str, object]) -> list[str]:
    # Numbers, truth values, lists and quoted text look the same in JSON and in TOML.
    return [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in values.items()]
