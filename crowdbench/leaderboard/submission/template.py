"""`crowdbench submit init`: create the folder of a new submission."""

import json
import math
import shutil
import tempfile
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import OutputError, SettingError, WeightsError
from crowdbench.files import unwritable
from crowdbench.leaderboard.submission.layout import NETWORK, NOTES
from crowdbench.leaderboard.submission.parse import PLACEHOLDER
from crowdbench.leaderboard.submission.schema import FILE, SCENES, SCHEMA, Track
from crowdbench.policies import OnnxPolicy
from crowdbench.report.text.words import environment
from crowdbench.scene import load_scene


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
    networks = _networks(policies, track)
    known = dict.fromkeys(scene for network in networks.values() for scene in network.card.scenes)
    one = networks[NETWORK].card if NETWORK in networks else None
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
    templates = environment(Path(__file__).with_name("templates"), html=False)
    # A JSON string, number or list of strings is valid in TOML.
    templates.filters["quoted"] = lambda value: json.dumps(value, ensure_ascii=False)
    facts = {
        "schema": SCHEMA,
        "fill": PLACEHOLDER,
        "name": name or folder.resolve().name,
        "date": date.today().isoformat(),
        "track": track,
        "scenes": chosen,
        "places": places,
        "data": f"recordings of {', '.join(known)}" if known else "",
        "protocol": "none" if one else "heldout",
        "parameters": _parameters(next(iter(networks.values())).path) if networks else None,
    }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".submission-") as temporary:
            made = Path(temporary) / folder.name
            for scene in chosen:
                for place in places:
                    if not (place == "policy" and one):
                        (made / scene / place).mkdir(parents=True)
            for to, network in networks.items():
                (made / to).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(network.path, made / to)
            for file in (FILE, NOTES):
                text = templates.get_template(f"{file}.j2").render(facts)
                (made / file).write_text(text, encoding="utf-8")
            made.rename(folder)
    except OSError as error:
        raise unwritable(folder, error) from error
    return chosen


def _networks(policies: Sequence[Path], track: Track) -> dict[str, OnnxPolicy]:
    if policies and track == "spawn":
        expected = "none, since track spawn uses straight walkers"
        raise SettingError("--policy", got="a policy", expected=expected)
    if any(path.is_file() for path in policies):
        if len(policies) > 1:
            got = f"a file among {len(policies)} policies"
            raise SettingError("--policy", got=got, expected="one file, or one folder per scene")
        return {NETWORK: OnnxPolicy(policies[0])}
    found: dict[str, OnnxPolicy] = {}
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
            found[f"{network.card.scene}/policy/{split}.onnx"] = network
    if len(found) < len(policies) * len(SPLITS[1:]):
        raise SettingError(
            "--policy", got="several folders for the same scene", expected="one folder per scene"
        )
    return found


def _parameters(path: Path) -> int:
    """Number of weights in a network's file; scalars are constants and not counted."""
    import onnx

    graph = onnx.load(path).graph
    floats = (onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16, onnx.TensorProto.DOUBLE)
    return sum(math.prod(t.dims) for t in graph.initializer if t.data_type in floats and t.dims)
