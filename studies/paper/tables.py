"""The tables of the page that no claim needs."""

from collections.abc import Sequence

import numpy as np

from crowdbench.report.text.words import NOTHING, digits
from studies.markdown import table
from studies.paper.evidence import NEURAL, Evidence
from studies.paper.fits import (
    CODE,
    COMPARED,
    LITERAL,
    POISSON,
    POISSON_CODE,
    SHIPPED,
    Configuration,
    windowed,
)
from studies.paper.measures import Numbers, pm
from studies.paper.presence import LAG_S
from studies.paper.study import SCHEMES

_ALPHA = 0.05


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
                "yes" if least * len(tests) > _ALPHA else "no",
            ]
        )
    head = ["model", "gaps per sample", "KS statistic", "smallest p", "agrees"]
    return table(head, lines)


def arrivals(of: Evidence) -> str:
    """Statistics of the arrivals of the recording and of each model's samples."""
    seen = of.bursts
    lines = [["recorded", f"{seen.persons:,}", digits(seen.fano), digits(seen.correlation)]]
    for model in COMPARED:
        persons = [bursts.persons for bursts in of.draws(model)]
        ranges = (_between(of, model, name) for name in ("fano", "correlation"))
        lines.append([model.label, f"{np.mean(persons):,.0f}", *ranges])
    counted = f"variance / mean in {seen.interval_s:.3g} s"
    return table(["", "people", counted, "correlation of areas"], lines)


def windows_and_strides(of: Evidence) -> str:
    """N(t) of each model, window and stride: the paper's Table I and Fig. 7."""
    head = [
        "model", "samples of", "mean N", "sd of N", f"autocorrelation at {LAG_S:g} s",
        "distance", "nats per person", "training (s)",
    ]  # fmt: skip
    lines = []
    for k, scheme in enumerate(SCHEMES):
        length = f"{scheme} × {-(-of.scene.recording.frames // scheme):,}"
        alone = Numbers.of([of.present[k]], of.present[k])
        lines.append(["recorded", length, *_numbers(alone), NOTHING, NOTHING])
        for model in [POISSON, POISSON_CODE, SHIPPED, *windowed()]:
            more = [NOTHING, NOTHING]
            if k == 0:
                each = of.samples[model]
                nats = [sample.nats for sample in each if sample.nats is not None]
                took_s = [sample.training_s for sample in each]
                more = [
                    pm(nats if np.ptp(nats) else nats[:1]),
                    f"{np.mean(took_s):.0f}" if model.window_frames else NOTHING,
                ]
            lines.append([model.label, length, *_numbers(of.numbers(model, k)), *more])
    return table(head, lines, text=2)


def training_s(found: Sequence[Evidence]) -> float:
    """CPU time of all fits, seconds; fits of which there are several samples count once."""
    total_s = 0.0
    for of in found:
        for model in windowed():
            times = [sample.training_s for sample in of.samples[model]]
            total_s += times[0] if model.spawn == LITERAL.spawn else sum(times)
    return total_s


def _numbers(of: Numbers) -> list[str]:
    known = [c for c in of.correlation if c is not None]
    return [pm(of.mean), pm(of.sd), pm(known) if known else NOTHING, pm(of.distance)]


def _between(of: Evidence, model: Configuration, name: str) -> str:
    low, high = of.spread(model, name)
    return f"{digits(low)} to {digits(high)}"
