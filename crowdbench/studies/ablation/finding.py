"""Whether the paper's finding holds, in words: nothing is said that no number carries.

The finding is that short windows degenerate to Poisson, and that longer ones are better.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench.report.text.words import digits
from crowdbench.scoring.score import LEVEL
from crowdbench.studies.ablation.measures import Numbers, spread
from crowdbench.studies.ablation.presence import Presence
from crowdbench.studies.ablation.study import Configuration

POISSON = Configuration("poisson-gmm")
_VERDICTS = {
    (True, True): "holds",
    (True, False): "holds in part: short windows degenerate to Poisson, but not all longer ones "
    "are better",
    (False, True): "holds in part: longer windows are better, but short ones do not degenerate to "
    "Poisson",
    (False, False): "does not hold: short windows do not degenerate to Poisson, and not all longer "
    "ones are better",
}
"""Whether short windows degenerate, and whether all longer ones are better."""


def finding(numbers: Mapping[Configuration, Numbers], recorded: Presence) -> tuple[str, str]:
    """Whether the finding holds in the samples of one scheme: the verdict, and why."""
    windows = sorted({c.window_frames for c in numbers if c.window_frames})
    short = [c for c in numbers if c.window_frames == windows[0]]
    longer = [c for c in numbers if c.window_frames > windows[0]]
    poisson = numbers[POISSON]
    both = [(c, what) for c in short for what in ("sd", "distance")]
    differs = _told_apart([(getattr(numbers[c], w), getattr(poisson, w)) for c, w in both])
    apart = {c: [w for (k, w), d in zip(both, differs, strict=True) if d and k == c] for c in short}
    partner = {c: _same_stride(short, c) for c in longer}
    changed = _told_apart([(numbers[c].distance, numbers[partner[c]].distance) for c in longer])
    better = {
        c: (_sign(numbers[partner[c]].distance, numbers[c].distance) if d else 0)
        for c, d in zip(longer, changed, strict=True)
    }
    degenerate = not any(apart.values())
    return _VERDICTS[degenerate, all(sign > 0 for sign in better.values())], " ".join(
        [
            _of_short(numbers, recorded, short, apart),
            *(_of_window(numbers, w, windows[0], better) for w in windows[1:]),
        ]
    )


def _of_short(
    numbers: Mapping[Configuration, Numbers],
    recorded: Presence,
    short: Sequence[Configuration],
    apart: Mapping[Configuration, Sequence[str]],
) -> str:
    """The shortest windows against Poisson."""
    poisson = numbers[POISSON]
    sds = " and ".join(f"{_pm(numbers[c].sd)} (stride {c.stride_frames})" for c in short)
    distances = " and ".join(_pm(numbers[c].distance) for c in short)
    verdicts = [f"with stride {c.stride_frames} they {_against(apart[c])}" for c in short]
    if len({tuple(apart[c]) for c in short}) == 1:
        verdicts = [f"they {_against(apart[short[0]])}"]
    return (
        f"With windows of {short[0].window_frames} frames the standard deviation of N(t) is {sds}, "
        f"poisson-gmm’s {_pm(poisson.sd)}, the recording’s {digits(recorded.sd)}; the distance to "
        f"the recording is {distances}, poisson-gmm’s {_pm(poisson.distance)}: "
        f"{', '.join(verdicts)}."
    )


def _against(apart: Sequence[str]) -> str:
    names = {"sd": "standard deviation", "distance": "distance"}
    if not apart:
        return "cannot be told apart from Poisson"
    return f"differ from Poisson in {' and '.join(names[what] for what in apart)}"


def _of_window(
    numbers: Mapping[Configuration, Numbers],
    window: int,
    shortest: int,
    better: Mapping[Configuration, int],
) -> str:
    """Longer windows against the shortest, stride by stride."""
    words = {1: "better", 0: "not told apart", -1: "worse"}
    each = [
        f"{_pm(numbers[c].distance)} with stride {c.stride_frames} ({words[sign]})"
        for c, sign in better.items()
        if c.window_frames == window
    ]
    return (
        f"Windows of {window} frames have a distance of {' and '.join(each)}, each held against "
        f"{shortest} frames with the same stride."
    )


def _same_stride(short: Sequence[Configuration], one: Configuration) -> Configuration:
    return next(c for c in short if c.stride_frames == one.stride_frames)


def _sign(a: Sequence[float], b: Sequence[float]) -> int:
    return int(np.sign(np.mean(a) - np.mean(b)))


def _pm(values: Sequence[float]) -> str:
    return f"{digits(float(np.mean(values)))} ± {spread(values):.2g}"


def _told_apart(pairs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> list[bool]:
    """Which means differ by more than the spread over samples explains.

    Welch's (1947) t-test of each pair, two-sided at 5 % over all of them by Holm (1979).
    """
    p = [_welch(a, b) for a, b in pairs]
    found = [False] * len(p)
    for step, index in enumerate(np.argsort(p, kind="stable").tolist()):
        if not p[index] <= LEVEL / (len(p) - step):
            break
        found[index] = True
    return found


def _welch(a: Sequence[float], b: Sequence[float]) -> float:
    """How likely means so different are by chance; 1 where a single sample has no spread."""
    from scipy.stats import t

    if min(len(a), len(b)) < 2:
        return 1.0
    va, vb = np.var(a, ddof=1) / len(a), np.var(b, ddof=1) / len(b)
    difference = float(np.mean(a) - np.mean(b))
    if va + vb == 0:
        return float(difference == 0)
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return float(2 * t.sf(abs(difference) / np.sqrt(va + vb), freedom))
