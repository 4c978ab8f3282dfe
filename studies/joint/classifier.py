"""Whether a classifier tells windows of sampled arrivals from recorded ones (C2ST).

This is the classifier two-sample test of Lopez-Paz and Oquab (2017, ICLR). A window has a fixed
number of people who enter one after another. A random forest is trained on recorded and sampled
windows of one part of the time, and tested on the rest. Its AUC is 0.5 if they cannot be told
apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.table import Numbers
from crowdbench.registry import recording_of, spawn_model
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents, blocks_of
from crowdbench.spawn.recorded_plans import plans_of

PEOPLE, MANY_PEOPLE = 10, 24
"""Number of people in a window: in most scenes, and where more than `_MANY` were recorded."""
_MANY = 5_000
_SETS, _PARTS = 5, 10
_TREES, _LEAF = 200, 5
_EARLY_S = 0.2  # added to gaps before the logarithm is taken: people may enter at the same time


@dataclass(frozen=True)
class ToldApart:
    """AUC for each fit of a model."""

    times: list[float]
    """Of the times alone."""
    both: list[float]
    """Of times and speeds."""


def told_apart(scene: Scene, models: Sequence[str], fits: int) -> dict[str, ToldApart]:
    """Compare samples of each model, fitted to the whole recording, with the recording.

    A sample is as long as the recording. People whose speed is not known are left out.

    Raises:
        WeightsError: the scene lacks fits.
        RecordingError: its recording has not been imported.
    """
    crowd = recording_of(scene)
    blocks = blocks_of(crowd, scene)
    persons, _, _ = blocks.of_arrivals(crowd)
    order = np.argsort(crowd.spawn_s[persons], kind="stable")
    recorded = _on_grid(crowd.spawn_s[persons][order], scene), plans_of(crowd).speed[persons][order]
    people = MANY_PEOPLE if len(persons) > _MANY else PEOPLE
    found = {}
    for name in models:
        of = ToldApart([], [])
        for fit in range(fits):
            model = spawn_model(name, scene, fit=fit % scene.protocol.fits)
            events = model.sample(blocks.exposure_s(), scene, np.random.default_rng(fit))
            sampled = _in_order(events, scene)
            of.times.append(_auc(_times(*recorded, people), _times(*sampled, people)))
            of.both.append(
                _auc(_times_and_speeds(*recorded, people), _times_and_speeds(*sampled, people))
            )
        found[name] = of
    return found


def _in_order(events: SpawnEvents, scene: Scene) -> tuple[Numbers, Numbers]:
    order = np.argsort(events.time_s, kind="stable")
    return _on_grid(events.time_s[order], scene), events.speed[order].astype(np.float64)


def _on_grid(time_s: Numbers, scene: Scene) -> Numbers:
    return np.asarray(np.floor(time_s / scene.grid_s + 1e-6) * scene.grid_s)


def _windows(length: int, people: int) -> Int[np.ndarray, "w people"]:
    """Indices of the people in each window; windows overlap."""
    begins = np.arange(0, max(0, length - people + 1), max(1, people // 4))
    return begins[:, None] + np.arange(people)


def _times(time_s: Numbers, speed: Numbers, people: int) -> Float[np.ndarray, "w f"]:
    """Logarithms of gaps, how they are distributed, and how long the window is."""
    time_s = time_s[np.isfinite(speed)]
    entered = time_s[_windows(len(time_s), people)]
    gap = np.log(np.diff(entered, axis=1) + _EARLY_S)
    return np.column_stack([gap, _spread(gap), entered[:, -1] - entered[:, 0]])


def _times_and_speeds(time_s: Numbers, speed: Numbers, people: int) -> Float[np.ndarray, "w f"]:
    known = np.log(speed[np.isfinite(speed)])
    of = known[_windows(len(known), people)]
    change = np.abs(np.diff(of, axis=1))
    return np.column_stack([_times(time_s, speed, people), of, _spread(of), _spread(change)])


def _spread(values: Float[np.ndarray, "w n"]) -> Float[np.ndarray, "w m"]:
    """Mean, standard deviation and sorted values of each window."""
    return np.column_stack([values.mean(axis=1), values.std(axis=1), np.sort(values, axis=1)])


def _auc(recorded: Float[np.ndarray, "w f"], sampled: Float[np.ndarray, "v f"]) -> float:
    """AUC of windows that the classifier has not seen, nor others that overlap with them."""
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.metrics import roc_auc_score
    from sklearn.model_selection import GroupKFold

    sampled = sampled[: len(recorded)]
    features = np.concatenate([recorded, sampled])
    is_sampled = np.repeat([0, 1], [len(recorded), len(sampled)])
    part = np.concatenate([np.arange(len(x)) * _PARTS // len(x) for x in (recorded, sampled)])
    guess = np.zeros(len(features))
    for seen, unseen in GroupKFold(_SETS).split(features, is_sampled, part):
        forest = RandomForestClassifier(_TREES, min_samples_leaf=_LEAF, random_state=0)
        forest.fit(features[seen], is_sampled[seen])
        guess[unseen] = forest.predict_proba(features[unseen])[:, 1]
    return float(roc_auc_score(is_sampled, guess))
