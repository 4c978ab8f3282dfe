"""`crowdbench submit init`: create the folder of a new submission."""

import json
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import OutputError, SettingError, WeightsError
from crowdbench.files import unwritable
from crowdbench.leaderboard.submission.layout import NETWORK, NOTES
from crowdbench.leaderboard.submission.parse import PLACEHOLDER
from crowdbench.leaderboard.submission.schema import FILE, SCENES, SCHEMA, Track
from crowdbench.policies import OnnxPolicy
from crowdbench.scene import load_scene

_TOML = """\
# Description of the submission. `crowdbench submit check` lists what is missing.
schema = {schema}
name = {name}  # as shown on the leaderboard
authors = ["{fill}: your name"]
contact = "{fill}: an e-mail address or an issue tracker"
link = "{fill}: https://… of the paper or the code"
licence = "{fill}: the SPDX identifier of these files' licence, such as Apache-2.0"

track = "{track}"  # {meaning}
kind = "learned"  # or "model-based"; "privileged" for policies in Python that use the state
scenes = {scenes}  # the overall score needs eth-v0, gc-v0 and forum-v0

# To use a model that comes with crowdbench instead of files, uncomment this:
{shipped}
[training]
data = {data}  # in your words
# "heldout": each fold's file was trained on that fold's training blocks only; "none": on no
# recording of these scenes; "full": on whole recordings (listed, not ranked).
protocol = "{protocol}"
parameters = {parameters}  # number of learned parameters, all files of one scene and fold together
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
# Files of this submission

| file | content |
|---|---|
{rows}
Then run `crowdbench submit check FOLDER`. This README is not
packed.
"""
_ROWS = {
    "policy": "| `SCENE/policy/fold0.onnx`, `fold1.onnx`, `fold2.onnx` | one network per fold, "
    "trained on that fold's training blocks and written by `crowdbench policy export` |\n| or "
    "`policy.onnx` | one network for all scenes, trained on none of their recordings; protocol "
    "`none` |\n| or `SCENE/policy/full.onnx` | one network per scene, trained on the whole "
    "recording; protocol `full` (listed, never ranked) |\n",
    "spawn": "| `SCENE/spawn/ntpp-gmm.safetensors`, or `poisson-gmm.json`, `poisson-groups.json`, "
    "`renewal-gmm.json`, `cox-gmm.json` | "
    "fits of a spawn model, as `crowdbench scene fit SCENE --out FOLDER` writes them |\n",
    "trajectories": "| or `SCENE/trajectories/0.parquet`, `1.parquet`, … | rollouts instead of "
    "models, as Parquet or CSV with the columns `person_id`, `frame`, `x` and `y` (listed, never "
    "ranked) |\n",
}


def start_submission(
    folder: Path,
    track: Track,
    *,
    name: str = "",
    scenes: Sequence[str] = (),
    policies: Sequence[Path] = (),
) -> list[str]:
    """Create the folder of a new submission, and return the ids of its scenes.

    Args:
        folder: path of the new folder.
        track: one of `schema.Track`.
        name: name on the leaderboard, by default that of the folder.
        scenes: by default those that the networks were trained on, else those of the overall score.
        policies: one folder per scene, with `fold0.onnx`, `fold1.onnx` and `fold2.onnx`; or one
            file of a network that was trained on none of the scenes.

    Raises:
        OutputError: the folder exists, or cannot be written.
        SettingError: the policies do not fit the track or each other, or the name is not printable.
        WeightsError: a policy's file is missing or broken.
        SceneError: a scene does not exist.
    """
    if folder.exists() or folder.is_symlink():
        raise OutputError(
            folder, got="an existing path", expected="a new folder", hint="Choose another path."
        )
    if not name.isprintable():
        raise SettingError("--name", got=ascii(name), expected="printable characters")
    files, read = _networks(policies, track)
    known = dict.fromkeys(scene for policy in read for scene in policy.card.scenes)
    one = read[0].card if NETWORK in files else None
    chosen = [load_scene(scene).id for scene in scenes or ([] if one else known)] or list(SCENES)
    if one and set(one.scenes) & set(chosen):
        raise SettingError(
            "--policy",
            got=f"a network trained on {one.trained_on}",
            expected=f"a folder with one network per fold, or a file trained on none of "
            f"{', '.join(chosen)}",
            hint="Use --scene to choose other scenes.",
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
    """Each network's file by its path in the submission, and the networks that were read."""
    if policies and track == "spawn":
        raise SettingError(
            "--policy",
            got="a policy",
            expected="none, since track spawn uses straight walkers",
        )
    if any(path.is_file() for path in policies):
        if len(policies) > 1:
            raise SettingError(
                "--policy",
                got=f"a file among {len(policies)} policies",
                expected="one file, or one folder per scene",
            )
        return {NETWORK: policies[0]}, [OnnxPolicy(policies[0])]
    files: dict[str, Path] = {}
    read = []
    for path in policies:
        lacking = [f"{p}.onnx" for p in SPLITS[1:] if not (path / f"{p}.onnx").is_file()]
        if lacking:
            raise WeightsError(
                path,
                got=f"no {', '.join(lacking)}" if path.is_dir() else "no such file or folder",
                expected="a folder with one network per fold, or one file",
                hint="A network trained on a whole recording is listed, not ranked: copy it to "
                "SCENE/policy/full.onnx in the submission's folder later."
                if path.is_dir()
                else "",
            )
        for split in SPLITS[1:]:
            network = OnnxPolicy(path / f"{split}.onnx")
            files[f"{network.card.scene}/policy/{split}.onnx"] = network.path
            read.append(network)
    if len(files) < len(read):
        raise SettingError(
            "--policy", got="several folders for the same scene", expected="one folder per scene"
        )
    return files, read


def _parameters(path: Path) -> int:
    """Number of weights in a network's file; scalars are constants and not counted."""
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
    # A JSON string is a valid TOML string.
    return json.dumps(text, ensure_ascii=False)
