"""The Markdown text of the study's page."""

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
    """The page in Markdown; the same samples and scores give the same bytes.

    `recorded` is the recording's N(t) for each of `SCHEMES`, `longest_s` the length of its longest
    observed stretch. The picture is linked in the folder `<scene>` beside the page.
    """
    numbers = [
        {c: Numbers.of([s.present[k] for s in each], recorded[k]) for c, each in samples.items()}
        for k in range(len(SCHEMES))
    ]
    found = [finding(of_scheme) for of_scheme in numbers]
    whole, tenth = (f"{-(-scene.recording.frames // scheme):,} frames" for scheme in SCHEMES)
    windows = sorted({c.window_frames for c in samples if c.window_frames})
    strides = sorted({c.stride_frames for c in samples if c.window_frames})
    times = len(next(iter(samples.values())))
    grid, long = _on_grid(scene, strides), _too_long(scene, windows, longest_s)
    return flowed(f"""# {scene.title}: windows and strides of ntpp-gmm on {scene.id}

{of_recording(scene)}

The founding paper (*Whenever, Wherever*, ICRA 2025) trains its neural spawn model on windows of
{_listed(windows)} frames with a stride of {_listed(strides)} frames (its text calls the stride an
overlap). It finds that short windows degenerate to Poisson, and that windows of
{_listed(windows[1:])} frames are better. Here, crowdbench’s own model is trained in this way on the
whole recording and compared with it. Generated with crowdbench {__version__} by

```sh
{shlex.join(["crowdbench", "ablation", named(scene)])}
```

## Does the finding hold?

{_finding(SCHEMES[0], whole, *found[0])}

{_finding(SCHEMES[1], tenth, *found[1])}

N(t) is the number of people present, and sd its standard deviation over time. Windows *degenerate
to Poisson* if neither the sd nor the distance to the recording differs significantly from those of
poisson-gmm. They are *better* if their distance is significantly smaller than with the shortest
windows and the same stride. Significance is tested by Welch’s t-test over the {times} samples at
5 %, with Holm’s procedure over the comparisons with Poisson, and over those between windows. ± is
the standard deviation over samples.

## Numbers

{_table(scene, numbers, recorded, samples, scores)}

*ntpp-gmm w/o* is trained on windows of w frames with a stride of o frames{grid}. {long}It has
{times} samples, which are fits with different seeds; poisson-gmm and renewal-gmm have one fit and
{times} rollout seeds. Walkers are straight. A sample is {SCHEMES[0]} rollout as long as the
recording ({whole}) and, separately, {SCHEMES[1]} rollouts of a tenth of it ({tenth}), which are
pooled. The recording is divided in the same way, and times without annotation are left out of the
rollouts too. ± is the standard deviation over samples.

The autocorrelation is that of N(t) over all pairs of frames 60 s apart in a stretch of observed
time. The metric of that name uses only pairs in the same time block ({scene.protocol.block_s:g} s),
so results pages show other values. *distance* is the Wasserstein-1 distance between the
distributions of N(t) of crowd and recording, divided by the recording’s mean; 0 means no
difference. Scores (S) are those of protocol `full` for the rollouts as long as the recording: 0 is
the score of the *anchor*, poisson-gmm × straight, 1 the average score of the true process. A score
needs several rollouts of a model. Here, the samples of a configuration are treated as rollouts of
one model, although each is from a separate fit, so the variation between fits counts as variation
of the model. *S crowd* is the mean over arrivals, presence, trips and space, with its 95 %
interval.
{NOTHING} marks metrics that are not scored. *nats per person* is the log-likelihood of the training
arrivals, which does not measure prediction. Training times are those of one core of the machine
that generated this page.

## Number of agents

![Number of agents]({scene.id}/{NAME})

Distribution of the number of people present, all samples pooled. Dots are medians, thick bars
contain 50 % of the frames, thin bars 90 %. The grey band contains the central 50 % of the
recording. Colours mark spawn models.
""")


def _finding(scheme: int, length: str, verdict: str, comparisons: str) -> str:
    return f"In samples of {scheme} × {length}, the paper’s finding {verdict}\n\n{comparisons}"


def _listed(values: Sequence[int]) -> str:
    *first, last = map(str, values)
    return f"{', '.join(first)} or {last}" if first else last


def _on_grid(scene: Scene, strides: Sequence[int]) -> str:
    """A note on strides that are rounded to the annotation grid; empty if none are."""
    steps = scene.grid_s / scene.dt_s
    rounded = {o: round(max(1, round(o / steps)) * steps, 6) for o in strides}
    changed = [f"{o} frames become {r:g}" for o, r in rounded.items() if r != o]
    if not changed:
        return ""
    return f" (rounded to the annotation grid of {scene.grid_s:g} s: {', '.join(changed)})"


def _too_long(scene: Scene, windows: Sequence[int], longest_s: float) -> str:
    """A note on windows longer than all observed stretches; empty if there are none."""
    longest = round(longest_s / scene.dt_s)
    cut = [window for window in windows if window >= longest]
    if not cut:
        return ""
    return (
        f"The longest stretch of observed time has {longest:,} frames. Windows of {_listed(cut)} "
        "frames are therefore whole stretches, whatever their stride; they differ only in the "
        "length of the silence after which the network restarts from its initial state. "
    )


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
    """Mean ± standard deviation; for a single value, only that value."""
    mean = f"{np.mean(values):.{decimals}f}".replace("-", "−")
    return f"{mean} ± {spread(values):.{decimals}f}" if len(values) > 1 else mean
