"""`scene.toml`: written for a new scene, and edited without losing comments."""

import re
from collections.abc import Sequence
from pathlib import Path

import msgspec
import tomlkit
from tomlkit.items import Array, Table

from crowdbench.files import write_text
from crowdbench.scene import SCHEMA, Protocol, Recording, Scene, Wall

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
    head = _HEAD.format(title=_one_line(scene.title), source=_one_line(source))
    for line in head.splitlines():
        document.add(tomlkit.comment(line))
    document["schema"] = SCHEMA
    for name in ("id", "title", "dt_s", "grid_s"):
        document[name] = getattr(scene, name)
    document["recording"] = _table(scene.recording)
    document["bounds"] = _table(scene.bounds, _WHY["bounds"])
    if scene.walls:
        walls = tomlkit.aot()
        for k, wall in enumerate(scene.walls):
            why = _WHY["walls"].format(walls=_one_line(walls_file)) if k == 0 else ""
            walls.append(_table(wall, why))
        document["walls"] = walls
    document["motion"] = _table(scene.motion, _WHY["motion"])
    document["spawning"] = _table(scene.spawning, _WHY["spawning"])
    clustering = tomlkit.table(is_super_table=True)
    clustering["default"] = _table(scene.clustering["default"], _WHY["clustering"])
    document["clustering"] = clustering
    document["walking"] = _table(scene.walking, _WHY["walking"])
    document["gate"] = _table(scene.gate, _WHY["gate"])
    document["protocol"] = _table(scene.protocol, _WHY["protocol"])
    return tomlkit.dumps(document)


def like_toml(
    like: Scene,
    *,
    name: str,
    title: str,
    recording: Recording,
    fits: int | None,
    rollouts_per_fit: int | None,
) -> str:
    """The text of a new scene's file that differs from that of `like` in these values only.

    The comment at the beginning is replaced, and the scored metrics are left out.
    """
    document = tomlkit.parse((like.folder / "scene.toml").read_text(encoding="utf-8"))
    document["id"], document["title"] = name, title
    document["recording"] = _table(recording)
    document["protocol"].pop("scored", None)
    for name, value in (("fits", fits), ("rollouts_per_fit", rollouts_per_fit)):
        if value is not None:
            document["protocol"][name] = value
    text = tomlkit.dumps(document)
    head = _HEAD.format(title=_one_line(title), source=f"{recording.name}, like {like.id}")
    comment = "".join(f"# {line}\n" for line in head.splitlines())
    return comment + text[re.search(r"^schema\b", text, re.MULTILINE).start() :]  # type: ignore[union-attr]


def write_scored(scene: Scene, scored: Sequence[str]) -> Path:
    """Set the scored metrics in a scene's `scene.toml`; comments and other values are kept."""
    path = scene.folder / "scene.toml"
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    document["protocol"]["scored"] = _lines(scored)
    write_text(path, tomlkit.dumps(document))
    return path


def with_recording(text: str, recording: Recording) -> str:
    """The text of a `scene.toml` with these values in `[recording]`."""
    document = tomlkit.parse(text)
    for name, value in msgspec.to_builtins(recording).items():
        if document["recording"].get(name) != value:
            document["recording"][name] = value
    return tomlkit.dumps(document)


def with_default_clustering(text: str, name: str) -> str:
    """The text of a `scene.toml` whose default clustering has the settings of another one."""
    document = tomlkit.parse(text)
    clustering = document["clustering"]
    chosen, default = clustering[name].unwrap(), clustering["default"]
    for key in set(default) - set(chosen):
        del default[key]
    for key, value in chosen.items():
        default[key] = value
    return tomlkit.dumps(document)


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


def _lines(values: Sequence[str]) -> Array:
    """An array with one value per line."""
    array = tomlkit.array()
    array.extend(values)
    return array.multiline(True)
