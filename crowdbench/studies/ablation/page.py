"""The page of the study in Markdown."""

import shlex
from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench import __version__
from crowdbench.report.text.markdown import flowed, table
from crowdbench.report.text.words import NOTHING, named, plainly, with_interval
from crowdbench.scene import Scene
from crowdbench.studies.ablation.finding import finding
from crowdbench.studies.ablation.measures import Numbers, Scores, spread
from crowdbench.studies.ablation.pictures import NAME
from crowdbench.studies.ablation.presence import LAG_S, Presence
from crowdbench.studies.ablation.study import SCHEMES, Configuration, Sample
from crowdbench.studies.results.page import of_recording

_METRICS = ("agents_over_time", "agents_sd", "autocorrelation")
_HEAD = (
    "crowd",
    "rollouts",
    "mean N",
    "sd of N",
    f"autocorrelation at {LAG_S:g} s",
    "distance",
    *(f"S {name.replace('_', ' ')}" for name in _METRICS),
    "S arrivals",
    "S presence",
    "S crowd",
    "nats per person",
    "training (s)",
)


def page(
    scene: Scene,
    recorded: Sequence[Presence],
    samples: Mapping[Configuration, Sequence[Sample]],
    scores: Mapping[Configuration, Scores],
    longest_s: float,
) -> str:
    """The page; the same samples and scores give the same bytes.

    `recorded` is the recording's N(t) for each of `SCHEMES`, `longest_s` the length of the longest
    stretch in which it is observed. The picture is linked in the folder
    `<scene>` beside the page.
    """
    numbers = [
        {c: Numbers.of([s.present[k] for s in each], recorded[k]) for c, each in samples.items()}
        for k in range(len(SCHEMES))
    ]
    said = [finding(of, presence) for of, presence in zip(numbers, recorded, strict=True)]
    whole, tenth = (f"{-(-scene.recording.frames // scheme):,} frames" for scheme in SCHEMES)
    windows = sorted({c.window_frames for c in samples if c.window_frames})
    strides = sorted({c.stride_frames for c in samples if c.window_frames})
    times = len(next(iter(samples.values())))
    return flowed(f"""# {scene.title}: windows and strides of ntpp-gmm on {scene.id}

{of_recording(scene)}

The founding paper (*Whenever, Wherever*, ICRA 2025) trains its neural spawn model on windows of
{_listed(windows)} frames, {_listed(strides)} frames apart (its text calls that an
overlap, its code uses it as a stride), and finds that short windows degenerate to Poisson while
{_listed(windows[1:])} frames do better. Here crowdbench’s own model is trained so, on the whole
recording, and compared with that recording. This page is made with crowdbench {__version__} by

```sh
{shlex.join(["crowdbench", "ablation", named(scene)])}
```

## Does the finding hold?

{_said(SCHEMES[0], whole, *said[0])}

{_said(SCHEMES[1], tenth, *said[1])}

Degenerate means here that neither the standard deviation of N(t), the number of people present, nor
its distance to the recording can be told from poisson-gmm’s; better means a smaller distance. Means
differ where they do by more than the spread over the {times} samples explains (Welch’s t-test at
5 %, by Holm’s procedure over the comparisons with Poisson, and over those of windows). ± is the
standard deviation over samples.

## Numbers

{_table(scene, numbers, recorded, samples, scores)}

*ntpp-gmm w/o* is trained on windows of w frames, o frames apart{_on_grid(scene, strides)}.
{_too_long(scene, windows, longest_s)} Each has
{times} samples, which are fits of different seeds; poisson-gmm and renewal-gmm have one fit and
{times} seeds of rollouts. Walkers are straight. A sample is {SCHEMES[0]} rollout as long as the
recording ({whole}) and, apart from it, {SCHEMES[1]} of a tenth ({tenth}), which count together; the
recording is cut the same way, and pauses of its annotation are left out of the rollouts too. ± is
the standard deviation over samples.

*sd of N* is the standard deviation over time. The autocorrelation is that of N(t) within
stretches of observed time, over all frames 60 s apart; the metric of that name counts only those
within one time block ({scene.protocol.block_s:g} s), so that pages of results have another
number. *distance* is the Wasserstein-1 distance of the distributions of N(t) to that of the
recording, divided by the recording’s mean; 0 is equal. Scores (S) are those of protocol `full`
for the rollouts as long as the recording: 0 is the anchor, poisson-gmm × straight, 1 what the
true process gets on average. A score needs several rollouts of a model; here the samples of a
configuration are taken for rollouts of one model, though each is of a fit of its own, so that the
spread over fits counts as the model’s own chance. *S crowd* is the mean over arrivals, presence,
lives and space, with its 95 % interval. {_without_scores(scene)} The likelihood is that of the
very arrivals that were trained on; it does not test anything new. Training times are those of one
core of the machine that made this page.

## Number of agents

![Number of agents]({scene.id}/{NAME})

Distribution of the number of people present, all samples together. Dots are medians, thick bars
hold half of the frames, thin ones 90 %; the grey band is the recording’s middle half. Colours are
spawn models.
""")


def _said(scheme: int, length: str, verdict: str, why: str) -> str:
    return f"**In samples of {scheme} × {length} the paper’s finding {verdict}.** {why}"


def _listed(values: Sequence[int]) -> str:
    *first, last = map(str, values)
    return f"{', '.join(first)} or {last}" if first else last


def _on_grid(scene: Scene, strides: Sequence[int]) -> str:
    """What is trained where the annotation grid cannot tell frames apart."""
    steps = scene.grid_s / scene.dt_s
    rounded = {o: round(max(1, round(o / steps)) * steps, 6) for o in strides}
    changed = [f"{o} frames become {r:g}" for o, r in rounded.items() if r != o]
    if not changed:
        return ""
    return f" (rounded to the annotation grid of {scene.grid_s:g} s: {', '.join(changed)})"


def _too_long(scene: Scene, windows: Sequence[int], longest_s: float) -> str:
    """What windows that nothing is as long as come to."""
    longest = round(longest_s / scene.dt_s)
    cut = [window for window in windows if window >= longest]
    if not cut:
        return ""
    return (
        f"No stretch of observed time is longer than {longest:,} frames: windows of {_listed(cut)} "
        "frames are whole stretches there, whatever their stride, and differ only in how long a "
        "silence has to be for the network to forget."
    )


def _without_scores(scene: Scene) -> str:
    if scene.protocol.scored:
        return f"{NOTHING} stands where a metric does not count on this scene."
    return "No metric of this scene counts yet, so that there are no scores."


def _table(
    scene: Scene,
    numbers: Sequence[Mapping[Configuration, Numbers]],
    recorded: Sequence[Presence],
    samples: Mapping[Configuration, Sequence[Sample]],
    scores: Mapping[Configuration, Scores],
) -> str:
    lines = []
    for k, scheme in enumerate(SCHEMES):
        rollouts = f"{scheme} × {-(-scene.recording.frames // scheme):,}"
        alone = Numbers.of([recorded[k]], recorded[k])
        lines.append(["recording", rollouts, *_numbers(alone), *[NOTHING] * 8])
        for configuration, each in samples.items():
            more = _more(scores[configuration], each) if scheme == 1 else [NOTHING] * 8
            of = numbers[k][configuration]
            lines.append([configuration.label, rollouts, *_numbers(of), *more])
    return table(_HEAD, lines, text=2)


def _numbers(of: Numbers) -> list[str]:
    known = [c for c in of.correlation if c is not None]
    return [
        _pm(of.mean, 1),
        _pm(of.sd, 2),
        _pm(known, 2) if known else NOTHING,
        _pm(of.distance, 3),
    ]


def _more(scores: Scores, samples: Sequence[Sample]) -> list[str]:
    each = [scores.metrics.get(name) for name in _METRICS]
    each += [scores.families.get(name) for name in ("arrivals", "presence")]
    return [
        *(NOTHING if score is None else plainly(score.value) for score in each),
        NOTHING if scores.crowd is None else with_interval(scores.crowd),
        _pm([s.nats for s in samples], 3),
        f"{np.mean([s.training_s for s in samples]):.0f}",
    ]


def _pm(values: Sequence[float], decimals: int) -> str:
    """Mean ± standard deviation, a single value alone."""
    mean = f"{np.mean(values):.{decimals}f}".replace("-", "−")
    return f"{mean} ± {spread(values):.{decimals}f}" if len(values) > 1 else mean
