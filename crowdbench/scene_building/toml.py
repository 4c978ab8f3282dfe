"""`scene.toml`: written for a new scene, and edited without losing comments."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import tomlkit
from tomlkit.items import Table

from crowdbench.files import write_text
from crowdbench.scene import SCHEMA, Protocol, Scene, Wall

_HEAD = """\
{title}. Made by `crowdbench scene create` from {source}.
After a change, run `crowdbench scene fit`, `crowdbench scene power --write` and
`crowdbench scene anchors` on this folder; `crowdbench scene check` reports what is inconsistent."""
_WHY = {
    "bounds": "The recorded extent plus half a metre. Whoever walks out has left the scene.",
    "walls": "From {walls}, clipped to the bounds.",
    "motion": "The goal radius is half a typical step.",
    "spawning": "As in the scenes that come with crowdbench.",
    "clustering": "The smallest radius with which DBSCAN leaves out less than 10 % of the starts, "
    "and of the ends. Clusters wider than widest_m are split.",
    "walking": "Time scales on which people move more than the noise of their positions.",
    "gate": "The score of walking is at most 0 beyond these limits of speed and arrivals.",
    "protocol": "Time blocks by the recording's length; `crowdbench scene power` selects what is "
    "scored.",
}


def scene_toml(scene: Scene, *, source: str, walls_file: str) -> str:
    """The text of a new scene's file: tables in the order of the shipped scenes, with comments."""
    document = tomlkit.document()
    for line in _HEAD.format(title=_one_line(scene.title), source=_one_line(source)).splitlines():
        document.add(tomlkit.comment(line))
    document["schema"] = SCHEMA
    for name in ("id", "title", "dt_s", "grid_s"):
        document[name] = getattr(scene, name)
    for name in ("recording", "bounds", "walls", "motion", "spawning", "clustering", "walking",
                 "gate", "protocol"):  # fmt: skip
        why = _WHY.get(name, "").format(walls=_one_line(walls_file))
        if name == "walls":
            walls = tomlkit.aot()
            for wall in scene.walls:
                walls.append(_table(wall, why))
                why = ""
            if scene.walls:
                document["walls"] = walls
        elif name == "clustering":
            document[name] = tomlkit.table(is_super_table=True)
            document[name]["default"] = _table(scene.clustering["default"], why)
        else:
            document[name] = _table(getattr(scene, name), why)
    return tomlkit.dumps(document)


def like_toml(like: Scene, scene: Scene) -> str:
    """The text of the file of a new scene, with the comments and tables of `like`.

    It has the new id, title, recording, and numbers of fits and rollouts. The comment at the
    beginning is replaced, and the scored metrics are left out.
    """
    document = _parsed(like)
    document["id"], document["title"] = scene.id, scene.title
    document["recording"] = _table(scene.recording)
    document["protocol"].pop("scored", None)
    for name in ("fits", "rollouts_per_fit"):
        document["protocol"][name] = getattr(scene.protocol, name)
    text = tomlkit.dumps(document)
    head = _HEAD.format(
        title=_one_line(scene.title), source=f"{scene.recording.name}, like {like.id}"
    )
    comment = "".join(f"# {line}\n" for line in head.splitlines())
    return comment + text[re.search(r"^schema\b", text, re.MULTILINE).start() :]  # type: ignore[union-attr]


def write_scored(scene: Scene, scored: Sequence[str]) -> Path:
    """Set the scored metrics in a scene's `scene.toml`; comments and other values are kept."""
    document, names = _parsed(scene), tomlkit.array()
    names.extend(scored)
    document["protocol"]["scored"] = names.multiline(True)
    path = scene.folder / "scene.toml"
    write_text(path, tomlkit.dumps(document))
    return path


def refitted_toml(scene: Scene, clustering: str) -> str:
    """The text of a scene's `scene.toml` with its recording, and another clustering as default."""
    document = _parsed(scene)
    for name, value in msgspec.to_builtins(scene.recording).items():
        if document["recording"].get(name) != value:
            document["recording"][name] = value
    chosen, default = document["clustering"][clustering].unwrap(), document["clustering"]["default"]
    for key in set(default) - set(chosen):
        del default[key]
    default.update(chosen)
    return tomlkit.dumps(document)


def _parsed(scene: Scene) -> Any:
    return tomlkit.parse((scene.folder / "scene.toml").read_text(encoding="utf-8"))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _table(values: msgspec.Struct, why: str = "") -> Table:
    table = tomlkit.table()
    if why:
        table.add(tomlkit.comment(why))
    for name, value in msgspec.to_builtins(values).items():
        if name != "scored":  # the power study adds it
            table.add(name, value)
    return table if isinstance(values, Wall | Protocol) else table.add(tomlkit.nl())
