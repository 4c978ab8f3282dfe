"""What the founding paper asked for, one neural process for all areas, and what came of it.

    python -m studies joint > docs/joint.md

writes a page that compares `joint-gmm`, and `ntpp-joint`, which has its times, with other models:
held-out likelihoods, scores from the leaderboard, long samples of Grand Central Terminal, and how
well a classifier tells samples from recordings.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.verification.entry import entry_path, read_entry
from crowdbench.scene import load_scene
from crowdbench.scene_building.spawn_diagnostics import Checked, check_models
from studies.joint.classifier import MANY_PEOPLE, PEOPLE, ToldApart, told_apart
from studies.joint.measures import NAMES, LongSample, held_out, long_samples
from studies.markdown import flowed, table

SCENES = ("eth-v0", "gc-v0", "forum-v0", "hotel-v0", "zara1-v0")
LONG, KNOWN = "gc-v0", "plaza-v0"
"""The scene of long samples, and the one whose true process is known."""
TIMES = ("poisson-gmm", "poisson-groups", "renewal-gmm", "ntpp-gmm", "cox-gmm", "joint-gmm")
ENTRIES = (
    *("poisson-gmm", "renewal-gmm", "ntpp-paper", "ntpp-gmm", "ntpp-plans", "cox-plans"),
    "ntpp-joint",
)
PLANS = ("ntpp-plans", "cox-plans", "ntpp-joint")
CONTROL = "block-replay"
SAMPLES, FITS = 10, 5
_INTRODUCTION = """# One neural process for the whole place

The founding paper models each spawn area by a neural process of its own, and ends with the limit of
that: independent processes cannot model how groups enter. It asks for joint models that are trained
end-to-end. `joint-gmm` is a step towards them. One small network sees the recent arrivals at an
area and at all areas ([spawn models](spawn-models.md)), and models when and where how many people
enter. It learns from the other places before it is fitted to one. Goals are not part of it:
`ntpp-joint` has its times, and the companions, ways and stops of `cox-plans` and `ntpp-plans`.
This page is the output of `python -m studies joint`.
"""
_HELD_OUT = """## Held-out likelihood

Nats per person of the blocks that a model was not fitted to, all folds together: mean over five
fits, and in brackets the least and most. Higher is better; a difference of 0.1 means that the
recorded arrivals of a person are 10 % more likely. The likelihood of `cox-gmm` is a lower bound.
*ten new hours* of the plaza are from its true process, which no model can beat.
"""
_SCORES = """## Scores on the track *spawn*

From the [leaderboard](../leaderboard/README.md): people walk straight, 0 is the score of
`poisson-gmm`, 1 that of a perfect model, with 95 % intervals.
"""
_LONG = """## Long samples

Processes that react to their own past can drift away from the recorded level, however well they
predict the next step. `joint-gmm` is trained against that: its rate may rise with a constant level
of arrivals only less than in proportion. {samples} samples of {long} as long as the recording,
walkers straight: mean, and in brackets the least and most.
"""
_APART = """## Can a classifier tell?

A random forest learns to tell windows of {people} people who enter one after another ({many} on
gc-v0) from recorded ones, by gaps and speeds. AUC in parts of the time that it has not seen, mean
over {fits} samples: 0.5 if it cannot tell. `{control}` plays recorded blocks again, so below 0.5 is
no merit.
"""


def page(scenes: Sequence[str] = SCENES) -> str:
    """The page.

    Raises:
        WeightsError: a scene lacks fits.
        RecordingError: its recording has not been imported.
    """
    nats = {scene: held_out(load_scene(scene), TIMES) for scene in (*scenes, KNOWN)}
    known = {of.model: of for of in check_models(load_scene(KNOWN))}
    long = long_samples(load_scene(LONG), PLANS, SAMPLES)
    apart = {s: told_apart(load_scene(s), (CONTROL, *PLANS), FITS) for s in scenes}
    facts: dict[str, str | int] = {"samples": SAMPLES, "long": LONG, "control": CONTROL}
    facts |= {"fits": FITS, "people": PEOPLE, "many": MANY_PEOPLE}
    parts = [
        *(_INTRODUCTION, _HELD_OUT, _likelihoods(nats, known), _best(nats)),
        *(_SCORES, _scores(scenes), _LONG, _long(long), _APART, _apart(apart)),
    ]
    return "\n\n".join(flowed(part.format(**facts)).strip() for part in parts) + "\n"


def _likelihoods(
    nats: Mapping[str, Mapping[str, list[float]]], known: Mapping[str, Checked]
) -> str:
    truth = next(of for name, of in known.items() if name not in TIMES and of.fresh is not None)
    lines = [
        [f"`{model}`", *(_nats(of[model]) for of in nats.values()), _fresh(known[model])]
        for model in TIMES
    ]
    nothing = ["–"] * (len(nats) - 1)
    lines.append(["the true process", *nothing, _nats([truth.heldout]), _fresh(truth)])
    return table(["model", *nats, "ten new hours"], lines)


def _fresh(of: Checked) -> str:
    return "–" if of.fresh is None else _nats([of.fresh])


def _best(nats: Mapping[str, Mapping[str, list[float]]]) -> str:
    won: dict[str, list[str]] = {}
    for scene, of in nats.items():
        mean = {model: float(np.mean(each)) for model, each in of.items()}
        won.setdefault(max(mean, key=mean.__getitem__), []).append(scene)
    each = [f"`{model}` on {_and(scenes)}" for model, scenes in won.items()]
    return f"The most likely model of held-out arrivals is {_and(each)}."


def _and(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _scores(scenes: Sequence[str]) -> str:
    lines = []
    for name in ENTRIES:
        found = scores(read_entry(entry_path(Path("leaderboard/entries"), name)))
        row = [f"`{name}`"]
        for view in (*(View(scene=scene) for scene in scenes), View()):
            if view not in found:
                row.append("–")
                continue
            low, high = found[view].interval
            row.append(f"{_number(found[view].value)} [{_number(low)}, {_number(high)}]")
        lines.append(row)
    return table(["model", *scenes, "overall"], lines)


def _long(long: Mapping[str, list[LongSample]]) -> str:
    (recorded,) = (of.numbers() for of in long["recorded"])
    sampled = {name: np.array([of.numbers() for of in long[name]]) for name in PLANS}
    lines = [
        [what, _number(recorded[k]), *(_range(of[:, k].tolist()) for of in sampled.values())]
        for k, what in enumerate(NAMES)
    ]
    return table(["", "recorded", *(f"`{name}`" for name in PLANS)], lines)


def _apart(apart: Mapping[str, Mapping[str, ToldApart]]) -> str:
    lines = [
        [f"`{model}`", what, *(f"{np.mean(getattr(of[model], kind)):.2f}" for of in apart.values())]
        for model in (CONTROL, *PLANS)
        for what, kind in (("times", "times"), ("times and speeds", "both"))
    ]
    return table(["model", "seen", *apart], lines, text=2)


def _range(values: list[float]) -> str:
    return f"{_number(float(np.mean(values)))} [{_number(min(values))}, {_number(max(values))}]"


def _nats(values: list[float]) -> str:
    mean = f"{np.mean(values):.3f}"
    spread = f" [{min(values):.3f}, {max(values):.3f}]" if len(values) > 1 else ""
    return (mean + spread).replace("-", "−")


def _number(value: float) -> str:
    return (f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}").replace("-", "−")
