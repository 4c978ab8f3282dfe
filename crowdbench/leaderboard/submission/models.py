"""Check the models of a submission: networks, fits of spawn models, names of shipped models."""

import re
from dataclasses import replace
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import WeightsError
from crowdbench.leaderboard.submission.errors import Problems
from crowdbench.leaderboard.submission.layout import NETWORK, Layout, splits_of
from crowdbench.leaderboard.submission.limits import LARGEST_FITS
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.registry import FITTED, POLICIES, WEIGHTS, policy, policy_source, trained_policies
from crowdbench.scene import load_scene
from crowdbench.spawn.areas import read_areas

FARTHEST_M = 20.0
"""Largest range of the rays of a submitted network, and of the bounds that it sees. With
longer ones it would know its place, and with it the person whose recorded path it is to walk."""
_BASELINE = re.compile(r"(crowdbench\.)?baselines\.[a-z_]+:[A-Z][A-Za-z]*")
"""A class of `crowdbench.baselines`. Submissions to version 0.1 left out the package's name."""


def check_models(folder: Path, declared: Declared, layout: Layout, problems: Problems) -> None:
    """Read every model with its own reader; problems are added to `problems`."""
    _check_names(declared, problems)
    for name in layout.networks:
        with problems.collected(folder):
            network = OnnxPolicy(folder / name)
            _check_training(name, network.card, declared, problems)
            _check_sight(name, network.card, problems)
            network.check_rows()
    for scene, name in layout.weights.items():
        with problems.collected(folder):
            _read_weights(folder / name, scene)
    if declared.kind == "privileged" and (layout.networks or layout.weights):
        got = "'privileged'"
        expected = "learned or model-based, since files receive observations, not the state"
        problems.refuse(f"{FILE}, kind", got=got, expected=expected, hint="Choose one of the two.")


def shipped_class(named: str) -> str:
    """The name of a shipped policy as an argument of `registry.policy`."""
    return f"crowdbench.{named}" if named.startswith("baselines.") else named


def shipped_files(declared: Declared) -> dict[str, Path]:
    """Files of the shipped models that a submission names, by their path in crowdbench."""
    found: dict[str, Path] = {}
    for place in map(load_scene, declared.scenes):
        names = [file for file, model in WEIGHTS.items() if model == declared.shipped_spawn]
        if parameters := policy_source(declared.shipped_policy, place).parameters:
            names.append(parameters.name)
        if declared.shipped_policy in trained_policies(place):
            folder = f"policies/{declared.shipped_policy}"
            names += [f"{folder}/{split}.onnx" for split in splits_of(declared)]
        found |= {f"scenes/{place.id}/{name}": place.folder / name for name in names}
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


def _check_training(name: str, card: PolicyCard, declared: Declared, problems: Problems) -> None:
    """Refuse a network that was trained on other data than its path and protocol say."""
    scene, _, file = name.partition("/")
    split = file.removeprefix("policy/").removesuffix(".onnx")
    if declared.training.protocol != "none" and name != NETWORK:
        fits = (card.scene, card.split) == (scene, split)
        expected = f"one trained on {split} of {scene}"
        hint = (
            "Train a network for this split. If it was trained on none of the submission's scenes, "
            'use training.protocol "none".'
        )
    else:
        fits = not set(card.scenes) & set(declared.scenes)
        expected = "one trained on no recording of the submission's scenes"
        hint = 'Train one on other scenes, or one for each fold with training.protocol "heldout".'
    if not fits:
        got = f"a network trained on {card.trained_on}"
        problems.refuse(name, got=got, expected=expected, hint=hint)


def _check_sight(name: str, card: PolicyCard, problems: Problems) -> None:
    """Refuse a network that sees further than people do, and so would know where it is."""
    if card.with_rays and card.ray_range_m > FARTHEST_M:
        got = f"a network with a ray_range_m of {card.ray_range_m:g}"
        expected = f"at most {FARTHEST_M:g} m"
        problems.refuse(name, got=got, expected=expected, hint="Train it with shorter rays.")


def _check_names(declared: Declared, problems: Problems) -> None:
    """Refuse a shipped model that does not exist or does not fit the track."""
    for name, track, other in (
        ("shipped_policy", "spawn", "straight walkers"),
        ("shipped_spawn", "walk", "the recorded arrivals"),
    ):
        if getattr(declared, name) and declared.track == track:
            got = repr(getattr(declared, name))
            expected = f"no such field, since track {track} uses {other}"
            hint = "Remove it, or choose the track crowd."
            problems.refuse(f"{FILE}, {name}", got=got, expected=expected, hint=hint)
            return
    named = declared.shipped_policy
    if not named or named in POLICIES:
        return
    if _BASELINE.fullmatch(named):
        with problems.collected(Path()):
            policy(shipped_class(named), declared.scenes[0])
        return
    for place in map(load_scene, declared.scenes):
        trained = trained_policies(place)
        splits = splits_of(declared) if named in trained else ()
        files = [policy_source(named, place).network(split) for split in splits]
        if not (files and all(file is not None and file.is_file() for file in files)):
            known = (*POLICIES, *trained, "crowdbench.baselines.MODULE:Class")
            got = repr(named)
            expected = f"a policy that comes with {place.id}: {', '.join(known)}"
            hint = "Submit ONNX files for other policies."
            problems.refuse(f"{FILE}, shipped_policy", got=got, expected=expected, hint=hint)
