"""The claims of the founding paper, each with a verdict and the numbers that it is based on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.report.text.words import NOTHING, digits
from studies.markdown import table
from studies.paper.bursts import LEAST, mode, share
from studies.paper.evidence import BASELINE, NEURAL, Evidence
from studies.paper.fits import (
    COMPARED,
    LITERAL,
    POISSON,
    RECORDED,
    SHIPPED,
    STRIDES_FRAMES,
    WINDOWS_FRAMES,
    Configuration,
)
from studies.paper.measures import difference, pm, signs
from studies.paper.pictures import AGENTS, BURSTS
from studies.paper.study import SCHEMES

HOLDS, IN_PART, FAILS, UNDECIDED = "holds", "holds in part", "does not hold", "undecided"
SPIKE = (4, 5)
MARGIN = 0.25
"""Windows are like Poisson if they close or widen the gap to the recording by less than this."""
_RESULTS = {-1: "lower", 0: "no significant difference", 1: "higher"}


@dataclass(frozen=True)
class Claim:
    """A claim, whether it holds on a scene, and why."""

    title: str
    verdict: str
    """A few words; `NOTHING` if the claim cannot be checked on the scene."""
    why: str = ""
    """Paragraphs and tables in Markdown; empty if the claim is about another scene."""
    pictures: tuple[str, ...] = ()
    """Files of the pictures that show it."""


def claims(of: Evidence) -> list[Claim]:
    """All claims, in the order of the page."""
    return [_bursts(of), _closer(of), _spike(of), _independence(of), _dwell(of), _windows(of)]


def _bursts(of: Evidence) -> Claim:
    low, high = of.spread(POISSON, "fano")
    covered = [name for model, name in NEURAL.items() if _inside(of, model, "fano")]
    return Claim(
        "Poisson arrivals miss the bursts",
        _enough(of, HOLDS if of.bursts.fano > high else FAILS),
        f"The number of people who enter in {_intervals(of)} has a variance of "
        f"{digits(of.bursts.fano)} times its mean in the recording. 95 % of the samples of "
        f"poisson-gmm have {digits(low)} to {digits(high)}. The recorded value lies within the "
        f"samples’ range for {_listed(covered) or 'none of the neural models'}.",
        (BURSTS,),
    )


def _closer(of: Evidence) -> Claim:
    metrics = {"inter_spawn": "time between arrivals", "agents_over_time": "people present"}
    pairs = [(model, metric) for model in NEURAL for metric in metrics]
    values = {
        (model, metric): (
            of.distances(model, of.walker, metric),
            of.distances(BASELINE[model], of.walker, metric),
        )
        for model, metric in pairs
    }
    by = dict(zip(pairs, signs(list(values.values())), strict=True))
    verdicts = {model: _verdict([by[model, metric] < 0 for metric in metrics]) for model in NEURAL}
    lines = [
        [
            NEURAL[model],
            metrics[metric],
            pm(values[model, metric][0]),
            f"{BASELINE[model].model}: {pm(values[model, metric][1])}",
            _RESULTS[by[model, metric]],
        ]
        for model, metric in pairs
    ]
    head = ["model", "distribution", "distance", "of Poisson", "result"]
    return Claim(
        "The neural process is closer than Poisson in inter-spawn times and people present",
        _by_model(verdicts),
        "Distances to the recording (Wasserstein-1, see `docs/metrics.md`), with "
        f"{of.walker} walkers. The published code has a Poisson process of its own, "
        f"`poisson-paper`.\n\n{table(head, lines, text=2)}",
        ("inter_spawn.png", "agents_over_time.png"),
    )


def _spike(of: Evidence) -> Claim:
    title = "Ten frames of Grand Central most often have 4 or 5 spawns"
    if of.scene.recording.name != "gc":
        return Claim(title, NOTHING)
    people, frames = of.bursts.people, of.bursts.occupied
    found = [f"{mode(people)}", _percent(people), f"{mode(frames)}", _percent(frames)]
    lines, too = [["recorded", *found]], []
    for model in COMPARED:
        summed = {
            name: _summed([getattr(bursts, name) for bursts in of.draws(model)])
            for name in ("people", "occupied")
        }
        cells = [cell for c in summed.values() for cell in (f"{mode(c)}", _percent(c))]
        lines.append([model.model, *cells])
        if mode(summed["occupied"]) in SPIKE:
            too.append(model.model)
    if mode(people) in SPIKE:
        verdict = HOLDS
    else:
        verdict = "for frames, not for people" if mode(frames) in SPIKE else FAILS
    most = 10 * of.scene.dt_s / of.scene.grid_s
    head = ["", "people: most often", "4 or 5", "frames: most often", "4 or 5"]
    return Claim(
        title,
        verdict,
        f"In ten frames ({10 * of.scene.dt_s:.3g} s), *people* is the number of people who enter, "
        "*frames* the number of frames in which anybody enters, which is what the paper’s code "
        f"counts. Positions are annotated every {of.scene.grid_s:g} s, so at most {most:g} of ten "
        "frames can have an entry. People of a model enter at the next annotated time, as those "
        "of the recording do. "
        + (f"Then {_listed(too)} most often have 4 or 5 such frames too." if too else "")
        + f"\n\n{table(head, lines)}",
        ("spawns_per_10_frames.png",),
    )


def _independence(of: Evidence) -> Claim:
    low, high = of.spread(LITERAL, "correlation")
    own = of.spread(SHIPPED, "correlation")
    recorded = of.bursts.correlation
    verdict = HOLDS if recorded > high else FAILS if recorded < low else UNDECIDED
    return Claim(
        "Modelling areas independently loses something",
        _enough(of, verdict),
        f"The mean correlation between areas of the numbers of people who enter in "
        f"{_intervals(of)} is {digits(recorded)} in the recording. 95 % of the samples have "
        f"{digits(low)} to {digits(high)} with the paper’s model, {digits(own[0])} to "
        f"{digits(own[1])} with crowdbench’s ntpp-gmm. Both model areas independently.",
        (BURSTS,),
    )


def _dwell(of: Evidence) -> Claim:
    title = "Cloned walkers stay as long as the recorded people"
    policies = [policy for model, policy in of.walked if model == RECORDED]
    lines = [["recorded", digits(of.recorded("dwell")), f"up to {digits(of.dwell_noise)}"]]
    lines += [
        [
            policy,
            pm(of.values(RECORDED, policy, "dwell")),
            pm(of.distances(RECORDED, policy, "dwell")),
        ]
        for policy in policies
    ]
    shown = table(["policy", "dwell time (s)", "distance"], lines)
    how = (
        "Walkers under the recorded arrivals. *as long*: their mean distance of dwell times is at "
        "most that of 95 % of the resamples of the recording’s time blocks, shown in the first row."
    )
    if of.walker == "straight":
        return Claim(title, NOTHING, f"The scene has no policy bc-paper. {how}\n\n{shown}")
    cloned, straight = (of.distances(RECORDED, p, "dwell") for p in (of.walker, "straight"))
    (sign,) = signs([(cloned, straight)])
    if float(np.mean(cloned)) <= of.dwell_noise:
        verdict = HOLDS
    else:
        verdict = "no, but closer than straight walkers" if sign < 0 else FAILS
    than = f"significantly {_RESULTS[sign]} than" if sign else "not significantly different from"
    return Claim(
        title,
        verdict,
        f"{how} The distance of {of.walker} is {than} that of straight walkers.\n\n{shown}",
        ("dwell.png",),
    )


def _windows(of: Evidence) -> Claim:
    shortest, *longer = WINDOWS_FRAMES
    title = f"Windows of {shortest} frames degenerate to Poisson"
    gap = of.present[0].sd - float(np.mean(of.numbers(POISSON, 0).sd))
    pairs = [(model, w, o) for model in NEURAL for w in longer for o in STRIDES_FRAMES]
    found = signs(
        [
            (of.numbers(m.at(w, o), 0).distance, of.numbers(m.at(shortest, o), 0).distance)
            for m, w, o in pairs
        ]
    )
    better = dict(zip(pairs, found, strict=True))
    verdicts, lines = {}, []
    for model, name in NEURAL.items():
        closed = [_closed(of, model.at(shortest, o), gap) for o in STRIDES_FRAMES]
        improved = [better[model, w, o] < 0 for w in longer for o in STRIDES_FRAMES]
        verdicts[model] = _window_verdict(closed, improved) if gap > 0 else NOTHING
        shown = [f"{_whole(100 * low)} to {_whole(100 * high)} %" for low, high in closed]
        lines.append(
            [
                name,
                *(shown if gap > 0 else [NOTHING] * len(shown)),
                f"{sum(improved)} of {len(improved)}",
            ]
        )
    head = ["model", *(f"gap closed, {shortest}/{o}" for o in STRIDES_FRAMES), "longer better"]
    short_of = (
        f"The standard deviation of N(t), the number of people present, is "
        f"{digits(of.present[0].sd)} in the recording, and {digits(of.present[0].sd - gap)} with "
        "poisson-gmm. "
    )
    return Claim(
        title,
        _by_model(verdicts),
        f"{short_of}Windows of {shortest} frames are *like Poisson* if they close less than "
        f"{100 * MARGIN:.0f} % of this gap, and widen it by less: if the 95 % interval of the "
        f"share (Welch) is within ±{100 * MARGIN:.0f} % with both strides. "
        f"Windows of {' and '.join(map(str, longer))} frames are *better* if their distance to the "
        f"recorded distribution of N is significantly smaller than with {shortest} frames and the "
        "same stride; Holm’s procedure covers all such tests of a scene. The claim holds if both "
        f"are so. {SCHEMES[0]} rollout as long as the recording decides; "
        f"{SCHEMES[1]} short ones are in the table of windows and strides.\n\n"
        f"{table(head, lines)}",
        (AGENTS,),
    )


def _closed(of: Evidence, model: Configuration, gap: float) -> tuple[float, float]:
    """Interval of the share of the gap between Poisson and recording that a model closes."""
    low, high = difference(of.numbers(model, 0).sd, of.numbers(POISSON, 0).sd)
    return low / gap, high / gap


def _window_verdict(closed: Sequence[tuple[float, float]], better: Sequence[bool]) -> str:
    like = all(low > -MARGIN and high < MARGIN for low, high in closed)
    unlike = any(low > MARGIN or high < -MARGIN for low, high in closed)
    if like and all(better):
        return HOLDS
    if like or all(better):
        return IN_PART
    return FAILS if unlike else UNDECIDED


def _enough(of: Evidence, verdict: str) -> str:
    """The verdict, or none if there are too few intervals of observed time."""
    return verdict if of.bursts.intervals >= LEAST else NOTHING


def _intervals(of: Evidence) -> str:
    return f"{of.bursts.interval_s:.3g} s ({of.bursts.intervals} intervals)"


def _inside(of: Evidence, model: Configuration, name: str) -> bool:
    low, high = of.spread(model, name)
    return low <= getattr(of.bursts, name) <= high


def _verdict(parts: Sequence[bool]) -> str:
    if all(parts):
        return HOLDS
    return IN_PART if any(parts) else FAILS


def _by_model(verdicts: Mapping[Configuration, str]) -> str:
    """One verdict if all models agree, else that of each."""
    if len(set(verdicts.values())) == 1:
        return next(iter(verdicts.values()))
    return "; ".join(f"{NEURAL[model]}: {verdict}" for model, verdict in verdicts.items())


def _listed(names: Sequence[str]) -> str:
    *first, last = names or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _whole(value: float) -> str:
    return f"{value:.0f}".replace("-", "−")


def _percent(counts: Sequence[int]) -> str:
    return f"{100 * share(counts, SPIKE):.0f} %"


def _summed(each: Sequence[Sequence[int]]) -> list[int]:
    total = np.zeros(max(map(len, each)), dtype=np.int64)
    for counts in each:
        total[: len(counts)] += counts
    return total.tolist()
