"""`crowdbench submit init`: the folder that a submission begins with."""

import json
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from crowdbench.errors import OutputError, SettingError, WeightsError
from crowdbench.files import unwritable
from crowdbench.leaderboard.submission.layout import NETWORK, NOTES
from crowdbench.leaderboard.submission.parse import PLACEHOLDER
from crowdbench.leaderboard.submission.schema import FILE, SCENES, SCHEMA, Track
from crowdbench.policies import OnnxPolicy
from crowdbench.scene import load_scene
from crowdbench.trajectories.blocks import PARTS

_TOML = """\
# What this submission says of itself. `crowdbench submit check` tells what is missing.
schema = {schema}
name = {name}  # under which the leaderboard shows it
authors = ["{fill}: your name"]
contact = "{fill}: an e-mail address, or where issues are opened"
link = "{fill}: https://… of the paper or the code"
licence = "{fill}: of the files here, an SPDX identifier such as Apache-2.0"

track = "{track}"  # {meaning}
kind = "learned"  # or "model-based"; "privileged" sees the simulation's state, as no file does
scenes = {scenes}  # eth-v0, gc-v0 and forum-v0 make the overall score

# In place of files, what comes with crowdbench (take the # away):
{shipped}
[training]
data = {data}  # in your words
# "heldout": each fold's file has seen that fold's training blocks only; "none": no recording of
# these scenes; "full": whole recordings, which is listed, not ranked.
protocol = "{protocol}"
parameters = {parameters}  # learned numbers, all files of one scene and fold together
"""
_SHIPPED = {
    "policy": '# shipped_policy = "social-force"\n',
    "spawn": '# shipped_spawn = "ntpp-gmm"\n',
}
_MEANING = {
    "walk": "a policy, under the recorded arrivals",
    "spawn": "a spawn model, with straight walkers",
    "crowd": "a spawn model and a policy",
}
_README = """\
# What goes where

| file | what it is |
|---|---|
{rows}
Then `crowdbench submit check FOLDER` and `crowdbench submit pack FOLDER`. This file is for you: it
is not packed.
"""
_ROWS = {
    "policy": "| `SCENE/policy/fold0.onnx`, `fold1.onnx`, `fold2.onnx` | networks trained on what "
    "each fold trains on, by `crowdbench policy export` |\n| or `policy.onnx` | one network for "
    "all scenes that has seen none of their recordings; protocol `none` |\n| or "
    "`SCENE/policy/full.onnx` | one that has seen a whole recording: listed, never ranked; "
    "protocol `full` |\n",
    "spawn": "| `SCENE/spawn/ntpp-gmm.safetensors`, or `poisson-gmm.json`, `poisson-groups.json`, "
    "`renewal-gmm.json` | "
    "fits of a spawn model, as `crowdbench fit SCENE --out FOLDER` writes them |\n",
    "trajectories": "| or `SCENE/trajectories/0.parquet`, `1.parquet`, … | rollouts in place of "
    "models, or `.csv`, with the columns `person_id`, `frame`, `x` and `y`: listed, never "
    "ranked |\n",
}


def start_submission(
    folder: Path,
    track: Track,
    *,
    name: str = "",
    scenes: Sequence[str] = (),
    policies: Sequence[Path] = (),
) -> list[str]:
    """Write a submission's folder, and return its scenes.

    Args:
        folder: the new folder.
        track: one of `declared.Track`.
        name: under which the leaderboard is to show it, by default that of the folder.
        scenes: by default those that the networks know, or those of the overall score.
        policies: folders that hold `fold0.onnx` and so on, one for each scene; or one file, of a
            network that has seen none of the scenes.

    Raises:
        OutputError: the folder exists, or cannot be written.
        SettingError: the policies do not fit the track, or each other; or the name is no text.
        WeightsError: a policy's file is missing or broken.
        SceneError: there is no such scene.
    """
    if folder.exists() or folder.is_symlink():
        raise OutputError(
            folder, got="a folder that exists", expected="a new one", hint="Name another."
        )
    if not name.isprintable():
        raise SettingError("--name", got=ascii(name), expected="printable characters")
    files, read = _networks(policies, track)
    known = dict.fromkeys(policy.card.scene for policy in read)
    one = read[0].card if NETWORK in files else None
    chosen = [load_scene(scene).id for scene in scenes or ([] if one else known)] or list(SCENES)
    if one and one.scene in chosen:
        raise SettingError(
            "--policy",
            got=f"a network trained on {one.part} of {one.scene}",
            expected=f"a folder with one for each fold, or a file that has seen none of "
            f"{', '.join(chosen)}",
            hint="Other scenes are chosen by --scene.",
        )
    places = ["policy"] * (track != "spawn") + ["spawn"] * (track != "walk")
    fill = f"{PLACEHOLDER}: "
    data = f"recordings of {', '.join(known)}" if known else f"{fill}what it was trained on"
    text = _TOML.format(
        schema=SCHEMA,
        fill=PLACEHOLDER,
        name=_quoted(name or folder.resolve().name),
        track=track,
        meaning=_MEANING[track],
        scenes=json.dumps(chosen),
        shipped="".join(_SHIPPED[place] for place in places),
        data=_quoted(data),
        protocol="none" if one else "heldout",
        parameters=_parameters(read[0].path) if read else _quoted(f"{fill}a number"),
    )
    rows = "".join(_ROWS[place] for place in (*places, "trajectories"))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".submission-") as temporary:
            made = Path(temporary) / folder.name
            for scene in chosen:
                for place in places:
                    if not (place == "policy" and one):
                        (made / scene / place).mkdir(parents=True)
            for to, path in files.items():
                (made / to).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, made / to)
            (made / FILE).write_text(text, encoding="utf-8")
            (made / NOTES).write_text(_README.format(rows=rows), encoding="utf-8")
            made.rename(folder)
    except OSError as error:
        raise unwritable(folder, error) from error
    return chosen


def _networks(policies: Sequence[Path], track: Track) -> tuple[dict[str, Path], list[OnnxPolicy]]:
    """Each network's file by its place in the submission, and what was read of them."""
    if policies and track == "spawn":
        raise SettingError("--policy", got="one", expected="none: track spawn has straight walkers")
    if any(path.is_file() for path in policies):
        if len(policies) > 1:
            raise SettingError(
                "--policy",
                got=f"a file among {len(policies)} policies",
                expected="one file, or a folder for each scene",
            )
        return {NETWORK: policies[0]}, [OnnxPolicy(policies[0])]
    files: dict[str, Path] = {}
    read = []
    for path in policies:
        lacking = [f"{p}.onnx" for p in PARTS[1:] if not (path / f"{p}.onnx").is_file()]
        if lacking:
            raise WeightsError(
                path,
                got=f"no {', '.join(lacking)}" if path.is_dir() else "no such file or folder",
                expected="a folder with a network for each fold, or one file",
                hint="What has seen a whole recording is listed, not ranked: put it into the "
                "submission's folder later, as SCENE/policy/full.onnx."
                if path.is_dir()
                else "",
            )
        for part in PARTS[1:]:
            network = OnnxPolicy(path / f"{part}.onnx")
            files[f"{network.card.scene}/policy/{part}.onnx"] = network.path
            read.append(network)
    if len(files) < len(read):
        raise SettingError(
            "--policy", got="folders of networks of one scene", expected="one folder for each scene"
        )
    return files, read


def _parameters(path: Path) -> int:
    """How many weights a network's file holds; numbers without a dimension are constants."""
    import onnx

    graph = onnx.load(path).graph
    floats = (onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16, onnx.TensorProto.DOUBLE)
    return sum(_size(t.dims) for t in graph.initializer if t.data_type in floats and t.dims)


def _size(shape: Iterable[int]) -> int:
    size = 1
    for length in shape:
        size *= length
    return size


def _quoted(text: str) -> str:
    # Text looks the same in JSON and in TOML.
    return json.dumps(text, ensure_ascii=False)
