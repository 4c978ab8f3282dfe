"""The claims of the founding paper, each with a verdict and the numbers that it is based on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.report.text.markdown import table
from crowdbench.report.text.words import NOTHING, digits
from crowdbench.scene import Scene
from crowdbench.studies.paper.bursts import Bursts, mode, share
from crowdbench.studies.paper.fits import (
    CODE,
    COMPARED,
    LITERAL,
    POISSON,
    RECORDED,
    SHIPPED,
    STRIDES_FRAMES,
    WINDOWS_FRAMES,
    Configuration,
)
from crowdbench.studies.paper.measures import Numbers, pm, signs
from crowdbench.studies.paper.presence import Presence
from crowdbench.studies.paper.study import SCHEMES, Sample

HOLDS, IN_PART, FAILS = "holds", "holds in part", "does not hold"
NEURAL = {
    LITERAL: "the paper’s model",
    CODE: "its published code",
    SHIPPED: "crowdbench’s ntpp-gmm",
}
SPIKE = (4, 5)
_TAILS = (2.5, 97.5)
_RESULTS = {-1: "lower", 0: "no significant difference", 1: "higher"}
_ALPHA = 0.05


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a scene."""

    scene: Scene
    walker: str
    """Policy of the rollouts."""
    bursts: Bursts
    """Of the recorded arrivals."""
    present: Sequence[Presence]
    """The recorded number of people present, for each of `study.SCHEMES`."""
    typical: Mapping[str, float]
    """Typical values of the recording by metric."""
    samples: Mapping[Configuration, Sequence[Sample]]

    def numbers(self, of: Configuration, scheme: int) -> Numbers:
        """Statistics of N(t) of a model's samples for one of the schemes (an index)."""
        each = [sample.present[scheme] for sample in self.samples[of]]
        return Numbers.of(each, self.present[scheme])

    def draws(self, of: Configuration) -> list[Bursts]:
        """The statistics of all samples of a model's arrivals."""
        return [bursts for sample in self.samples[of] for bursts in sample.bursts]

    def spread(self, of: Configuration, name: str) -> tuple[float, float]:
        """Central 95 % of an attribute of `Bursts` over a model's samples."""
        values = [getattr(bursts, name) for bursts in self.draws(of)]
        low, high = np.percentile(values, _TAILS)
        return float(low), float(high)

    def distances(self, of: Configuration, policy: str, metric: str) -> list[float]:
        """Distances of a model's rollouts to the recording."""
        return [sample.walked[policy][metric].distance for sample in self.samples[of]]

    def values(self, of: Configuration, policy: str, metric: str) -> list[float]:
        """Typical values of a model's rollouts."""
        return [sample.walked[policy][metric].value for sample in self.samples[of]]


@dataclass(frozen=True)
class Claim:
    """A claim, whether it holds on a scene, and why."""

    title: str
    verdict: str
    """A few words."""
    why: str
    """Paragraphs and tables in Markdown."""


def claims(of: Evidence) -> list[Claim]:
    """All claims, in the order of the page."""
    return [_bursts(of), _closer(of), _spike(of), _independence(of), _dwell(of), _windows(of)]


def _bursts(of: Evidence) -> Claim:
    low, high = of.spread(POISSON, "fano")
    covered = [name for model, name in NEURAL.items() if _inside(of, model, "fano")]
    return Claim(
        "Poisson arrivals miss the bursts",
        HOLDS if of.bursts.fano > high else FAILS,
        f"The number of people who enter in 60 s has a variance of {digits(of.bursts.fano)} times "
        f"its mean in the recording. 95 % of the samples of poisson-gmm have {digits(low)} to "
        f"{digits(high)}. The recorded value lies within the samples’ range for "
        f"{_listed(covered) or 'none of the neural models'}.",
    )


def _closer(of: Evidence) -> Claim:
    metrics = {"inter_spawn": "time between arrivals", "agents_over_time": "people present"}
    pairs = [(model, metric) for model in NEURAL for metric in metrics]
    found = signs(
        [
            (of.distances(model, of.walker, metric), of.distances(POISSON, of.walker, metric))
            for model, metric in pairs
        ]
    )
    by = dict(zip(pairs, found, strict=True))
    verdicts = {model: _verdict([by[model, metric] < 0 for metric in metrics]) for model in NEURAL}
    lines = [
        [
            name,
            what,
            pm(of.distances(model, of.walker, metric)),
            pm(of.distances(POISSON, of.walker, metric)),
            _RESULTS[by[model, metric]],
        ]
        for model, name in NEURAL.items()
        for metric, what in metrics.items()
    ]
    head = ["model", "distribution", "distance", "of poisson-gmm", "result"]
    return Claim(
        "The neural process is closer than Poisson in inter-spawn times and people present",
        _by_model(verdicts),
        f"Distances to the recording (Wasserstein-1, see `docs/metrics.md`), with {of.walker} "
        f"walkers:\n\n{table(head, lines, text=2)}",
    )


def _spike(of: Evidence) -> Claim:
    people, occupied = of.bursts.people, of.bursts.occupied
    modes = mode(people), mode(occupied)
    if of.scene.recording.name != "gc":
        verdict = NOTHING
    elif modes[0] in SPIKE:
        verdict = HOLDS
    else:
        verdict = "holds for frames, not for people" if modes[1] in SPIKE else FAILS
    steps = of.scene.grid_s / of.scene.dt_s
    cause = (
        f"Positions are annotated in every {steps:g}nd frame, so that people can enter in at most "
        f"{10 / steps:g} of ten frames. The spike is an effect of the annotation. "
        if steps == 2
        else ""
    )
    lines = [["recorded", f"{modes[0]}", _percent(people), f"{modes[1]}", _percent(occupied)]]
    for model in COMPARED:
        draws = of.draws(model)
        summed = [
            _summed([getattr(bursts, name) for bursts in draws]) for name in ("people", "occupied")
        ]
        cells = [cell for counts in summed for cell in (f"{mode(counts)}", _percent(counts))]
        lines.append([model.model, *cells])
    head = ["", "people: most often", "4 or 5", "frames: most often", "4 or 5"]
    return Claim(
        "Ten frames of Grand Central most often have 4 or 5 spawns",
        verdict,
        f"In ten frames ({10 * of.scene.dt_s:.3g} s), *people* is the number of people who enter, "
        "*frames* the number of frames in which anybody enters, which is what the paper’s code "
        f"counts. {cause}\n\n{table(head, lines)}",
    )


def _independence(of: Evidence) -> Claim:
    low, high = of.spread(LITERAL, "correlation")
    own = of.spread(SHIPPED, "correlation")
    return Claim(
        "Modelling areas independently loses something",
        HOLDS if of.bursts.correlation > high else FAILS,
        "The mean correlation between areas of the numbers of people who enter in 60 s is "
        f"{digits(of.bursts.correlation)} in the recording. 95 % of the samples have {digits(low)} "
        f"to {digits(high)} with the paper’s model, {digits(own[0])} to {digits(own[1])} with "
        "crowdbench’s ntpp-gmm. Both model areas independently.",
    )


def _dwell(of: Evidence) -> Claim:
    title = "Cloned walkers stay as long as the recorded people"
    policies = list(of.samples[RECORDED][0].walked)
    lines = [
        [
            policy,
            pm(of.values(RECORDED, policy, "dwell")),
            pm(of.distances(RECORDED, policy, "dwell")),
        ]
        for policy in policies
    ]
    lines.insert(0, ["recorded", digits(of.typical["dwell"]), ""])
    shown = table(["policy", "dwell time (s)", "distance"], lines)
    if of.walker == "straight":
        return Claim(title, NOTHING, f"The scene has no policy bc-paper.\n\n{shown}")
    of_both = [of.distances(RECORDED, p, "dwell") for p in (of.walker, "straight")]
    (sign,) = signs([(of_both[0], of_both[1])])
    return Claim(
        title,
        {-1: HOLDS, 0: "not closer than straight walkers", 1: FAILS}[sign],
        f"Under the recorded arrivals, the distance of dwell times to the recording is "
        f"{'significantly ' if sign else 'not significantly '}"
        f"{'higher' if sign > 0 else 'lower'} than with straight walkers.\n\n{shown}",
    )


def _windows(of: Evidence) -> Claim:
    whole, verdicts, lines = of.scene.recording.frames, {}, []
    for model, name in NEURAL.items():
        for k, scheme in enumerate(SCHEMES):
            degenerate, better = _degenerates(of, model, k)
            if k == 0:
                verdicts[model] = _verdict([degenerate, better])
            length = f"{scheme} × {-(-whole // scheme):,} frames"
            lines.append([name, length, _yes(degenerate), _yes(better)])
    shortest, *longer = WINDOWS_FRAMES
    head = ["model", "samples", f"windows of {shortest} like Poisson", "longer windows better"]
    return Claim(
        f"Windows of {shortest} frames degenerate to Poisson",
        _by_model(verdicts),
        f"Windows of {shortest} frames are *like Poisson* if, with each stride, neither the "
        "standard deviation of N(t), the number of people present, nor its distance to the "
        "recording differs significantly from that of poisson-gmm. Windows of "
        f"{' and '.join(map(str, longer))} frames are *better* if their distance is significantly "
        f"smaller than with {shortest} frames and the same stride. The numbers are in the table of "
        f"windows and strides below.\n\n{table(head, lines, text=2)}",
    )


def _degenerates(of: Evidence, model: Configuration, scheme: int) -> tuple[bool, bool]:
    """Whether short windows are like Poisson, and whether longer windows are better."""
    poisson = of.numbers(POISSON, scheme)
    shortest, *longer = WINDOWS_FRAMES
    short = {o: of.numbers(model.at(shortest, o), scheme) for o in STRIDES_FRAMES}
    with_poisson = signs(
        [
            pair
            for n in short.values()
            for pair in ((n.sd, poisson.sd), (n.distance, poisson.distance))
        ]
    )
    with_short = signs(
        [
            (of.numbers(model.at(w, o), scheme).distance, short[o].distance)
            for w in longer
            for o in STRIDES_FRAMES
        ]
    )
    return not any(with_poisson), all(sign < 0 for sign in with_short)


def own_density(of: Evidence) -> str:
    """Whether samples of the paper's model follow the density that was trained."""
    lines = []
    for model in (LITERAL, CODE):
        tests = [sample.own for sample in of.samples[model] if sample.own is not None]
        least = min(test.p for test in tests)
        lines.append(
            [
                NEURAL[model],
                f"{np.mean([test.n for test in tests]):,.0f}",
                pm([test.statistic for test in tests]),
                f"{least:.2g}",
                _yes(least * len(tests) > _ALPHA),
            ]
        )
    head = ["model", "gaps per sample", "KS statistic", "smallest p", "agrees"]
    return table(head, lines)


def arrivals_table(of: Evidence) -> str:
    """Statistics of the arrivals of the recording and of each model's samples."""
    lines = [
        [
            "recorded",
            f"{of.bursts.persons:,}",
            digits(of.bursts.fano),
            digits(of.bursts.correlation),
        ]
    ]
    for model in COMPARED:
        persons = [bursts.persons for bursts in of.draws(model)]
        lines.append(
            [
                model.label,
                f"{np.mean(persons):,.0f}",
                *(_between(of, model, name) for name in ("fano", "correlation")),
            ]
        )
    return table(["", "people", "variance / mean in 60 s", "correlation of areas"], lines)


def _between(of: Evidence, model: Configuration, name: str) -> str:
    low, high = of.spread(model, name)
    return f"{digits(low)} to {digits(high)}"


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


def _percent(counts: Sequence[int]) -> str:
    return f"{100 * share(counts, SPIKE):.0f} %"


def _summed(each: Sequence[Sequence[int]]) -> list[int]:
    total = np.zeros(max(map(len, each)), dtype=np.int64)
    for counts in each:
        total[: len(counts)] += counts
    return total.tolist()


def _yes(answer: bool) -> str:
    return "yes" if answer else "no"
