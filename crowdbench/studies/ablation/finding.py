"""Whether the paper's finding holds, with the comparisons on which the verdict is based.

The finding is that short windows degenerate to Poisson, and that longer windows are better.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench.report.text.markdown import table
from crowdbench.report.text.words import digits
from crowdbench.scoring.score import holm
from crowdbench.studies.ablation.measures import Numbers, spread
from crowdbench.studies.ablation.study import Configuration

POISSON = Configuration("poisson-gmm")
_QUANTITIES = {"sd": "sd of N", "distance": "distance"}
"""The compared quantities (attributes of `Numbers`), and their names in the table."""
_RESULTS = {-1: "significantly lower", 0: "no significant difference", 1: "significantly higher"}
_Comparison = tuple[Configuration, Configuration, str]
"""A configuration, the one that it is compared with, and the quantity."""


def finding(numbers: Mapping[Configuration, Numbers]) -> tuple[str, str]:
    """Whether the finding holds in the samples of one scheme, and a table of the comparisons.

    Short windows degenerate if they do not differ significantly from Poisson. Longer windows are
    better if their distances are significantly smaller than those of short windows.
    """
    windows = sorted({c.window_frames for c in numbers if c.window_frames})
    short = [c for c in numbers if c.window_frames == windows[0]]
    longer = [c for c in numbers if c.window_frames > windows[0]]
    with_poisson = [(c, POISSON, quantity) for quantity in _QUANTITIES for c in short]
    with_short = [(c, _same_stride(short, c), "distance") for c in longer]
    differences = _differences(numbers, with_poisson)
    changes = _differences(numbers, with_short)
    degenerate = not any(differences)
    better = all(change < 0 for change in changes)
    verdict = (
        f"{('does not hold', 'holds in part', 'holds')[degenerate + better]}. Windows of "
        f"{windows[0]} frames degenerate to Poisson: {_yes(degenerate)}. All longer windows are "
        f"better: {_yes(better)}."
    )
    head = ["configuration", "compared with", "quantity", "value", "other value", "result"]
    lines = [
        [
            one.label,
            other.label,
            _QUANTITIES[quantity],
            _pm(getattr(numbers[one], quantity)),
            _pm(getattr(numbers[other], quantity)),
            _RESULTS[sign],
        ]
        for (one, other, quantity), sign in zip(
            [*with_poisson, *with_short], [*differences, *changes], strict=True
        )
    ]
    return verdict, table(head, lines, text=3)


def _yes(answer: bool) -> str:
    return "yes" if answer else "no"


def _same_stride(short: Sequence[Configuration], one: Configuration) -> Configuration:
    return next(c for c in short if c.stride_frames == one.stride_frames)


def _pm(values: Sequence[float]) -> str:
    return f"{digits(float(np.mean(values)))} ± {spread(values):.2g}"


def _differences(
    numbers: Mapping[Configuration, Numbers], comparisons: Sequence[_Comparison]
) -> list[int]:
    """Sign of each difference of means; 0 if it is not significant.

    Welch's (1947) t-tests over the samples, two-sided at 5 % over all comparisons by Holm (1979).
    """
    pairs = [(getattr(numbers[a], q), getattr(numbers[b], q)) for a, b, q in comparisons]
    significant = holm([_welch(a, b) for a, b in pairs])
    signs = [int(np.sign(np.mean(a) - np.mean(b))) for a, b in pairs]
    return [sign if differs else 0 for sign, differs in zip(signs, significant, strict=True)]


def _welch(a: Sequence[float], b: Sequence[float]) -> float:
    """p-value of Welch's t-test; 1 for a single sample, which has no spread."""
    from scipy.stats import ttest_ind

    if min(len(a), len(b)) < 2:
        return 1.0
    if np.ptp(a) == np.ptp(b) == 0:
        return float(a[0] == b[0])
    return float(ttest_ind(a, b, equal_var=False).pvalue)
