"""Check the models of a submission: networks, fits of spawn models, names of shipped models."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import CrowdbenchError, WeightsError
from crowdbench.leaderboard.submission.errors import RefusedError, collecting
from crowdbench.leaderboard.submission.layout import NETWORK, Layout, splits_of
from crowdbench.leaderboard.submission.limits import LARGEST_FITS
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.registry import FITTED, POLICIES, WEIGHTS, policy, policy_source, trained_policies
from crowdbench.scene import load_scene
from crowdbench.spawn.areas import read_areas

_BASELINE = re.compile(r"(crowdbench\.)?baselines\.[a-z_]+:[A-Z][A-Za-z]*")
"""A class of `crowdbench.baselines`. Submissions to version 0.1 left out the package's name."""


def check_models(
    folder: Path, declared: Declared, layout: Layout, problems: list[CrowdbenchError]
) -> None:
    """Read every model with its own reader; problems are added to `problems`."""
    problems += _wrong_names(declared)
    for name in layout.networks:
        with collecting(problems, folder):
            network = OnnxPolicy(folder / name)
            problems += _seen_too_much(name, network.card, declared)
            network.check_rows()
    for scene, name in layout.weights.items():
        with collecting(problems, folder):
            _read_weights(folder / name, scene)
    if declared.kind == "privileged" and (layout.networks or layout.weights):
        problems.append(
            RefusedError(
                f"{FILE}, kind",
                got="'privileged'",
                expected="learned or model-based, since files receive observations, not the state",
                hint="Choose one of the two.",
            )
        )


def shipped_class(named: str) -> str:
    """The name of a shipped policy as an argument of `registry.policy`."""
    return f"crowdbench.{named}" if named.startswith("baselines.") else named


def shipped_files(declared: Declared) -> dict[str, Path]:
    """Files of the shipped models that a submission names, by their path in crowdbench."""
    found: dict[str, Path] = {}
    for scene in declared.scenes:
        folder = load_scene(scene).folder
        if declared.shipped_policy in trained_policies(load_scene(scene)):
            networks = folder / "policies" / declared.shipped_policy
            files = [networks / f"{split}.onnx" for split in splits_of(declared)]
        else:
            files = []
        files += [folder / f for f, model in WEIGHTS.items() if model == declared.shipped_spawn]
        found |= {f"scenes/{scene}/{file.relative_to(folder)}": file for file in files}
    return found


def _read_weights(path: Path, scene: str) -> None:
    size, most = path.stat().st_size, LARGEST_FITS[path.suffix]
    if size > most:
        raise WeightsError(
            path, got=f"{size / 1e6:.1f} MB", expected=f"at most {most / 1e6:.0f} MB"
        )
    place = load_scene(scene)
    areas = read_areas(place)
    for split in SPLITS:
        FITTED[WEIGHTS[path.name]].read(replace(place, folder=path.parent), areas, split)


def _seen_too_much(name: str, card: PolicyCard, declared: Declared) -> Iterator[RefusedError]:
    """Yield a problem if a network was trained on other data than its path and protocol say."""
    scene, _, file = name.partition("/")
    split = file.removeprefix("policy/").removesuffix(".onnx")
    of_split = declared.training.protocol != "none" and name != NETWORK
    if (
        (card.scene, card.split) == (scene, split)
        if of_split
        else not set(card.scenes) & set(declared.scenes)
    ):
        return
    if of_split:
        expected = f"one trained on {split} of {scene}"
        hint = (
            "Train a network for this split. If it was trained on none of the submission's scenes, "
            'use training.protocol "none".'
        )
    else:
        expected = "one trained on no recording of the submission's scenes"
        hint = 'Train one on other scenes, or one for each fold with training.protocol "heldout".'
    got = f"a network trained on {card.trained_on}"
    yield RefusedError(name, got=got, expected=expected, hint=hint)


def _wrong_names(declared: Declared) -> Iterator[CrowdbenchError]:
    """Yield a problem for each shipped model that does not exist or does not fit the track."""
    for name, track, other in (
        ("shipped_policy", "spawn", "straight walkers"),
        ("shipped_spawn", "walk", "the recorded arrivals"),
    ):
        if getattr(declared, name) and declared.track == track:
            yield RefusedError(
                f"{FILE}, {name}",
                got=repr(getattr(declared, name)),
                expected=f"no such field, since track {track} uses {other}",
                hint="Remove it, or choose the track crowd.",
            )
            return
    named = declared.shipped_policy
    if not named or named in POLICIES:
        return
    if _BASELINE.fullmatch(named):
        problems: list[CrowdbenchError] = []
        with collecting(problems, Path()):
            policy(shipped_class(named), declared.scenes[0])
        yield from problems
        return
    for scene in declared.scenes:
        place = load_scene(scene)
        file = named in trained_policies(place)
        if not file or not all(_is_file(named, scene, split) for split in splits_of(declared)):
            known = (*POLICIES, *trained_policies(place), "crowdbench.baselines.MODULE:Class")
            yield RefusedError(
                f"{FILE}, shipped_policy",
                got=repr(named),
                expected=f"a policy that comes with {scene}: {', '.join(known)}",
                hint="Submit ONNX files for other policies.",
            )


def _is_file(named: str, scene: str, split: str) -> bool:
    file = policy_source(named, load_scene(scene)).network(split)
    return file is not None and file.is_file()
