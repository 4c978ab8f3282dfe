"""The Markdown text of the pages on the founding paper: one for each scene, and an overview."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from crowdbench import __version__
from crowdbench.report.text.words import NOTHING, digits, named
from crowdbench.scene import Scene
from studies.markdown import flowed, table
from studies.paper.claims import Claim
from studies.paper.evidence import Evidence
from studies.paper.fits import SAMPLES, windowed
from studies.paper.study import DRAWS, SCHEMES
from studies.paper.tables import (
    arrivals,
    own_density,
    training_s,
    windows_and_strides,
)
from studies.results.page import of_recording
from studies.results.pictures import Picture

SCHEMA = 1
_MODELS = "\n".join(
    (
        "- *the paper’s model*: `ntpp-paper`, a GRU and an MLP of 32 units for each area, one "
        "person per event in continuous time, 500 epochs with a learning rate of 1e-4;",
        "- *its published code*: the same model with what the code does otherwise: a linear head, "
        "an initial state of zeros, a learning rate of 5e-3, frames as events, training windows "
        "that begin with an event, and a sampler that clamps the state of the network;",
        "- *crowdbench’s ntpp-gmm*: with group sizes, a trained initial state, early stopping and "
        "calibrated rates; the fits that the scene ships;",
        "- `poisson-gmm`: constant rates; `poisson-paper`: with the rates of the published code;",
        "- `bc-paper`: the paper’s behaviour cloning, with the learning rate of its published code "
        "(`docs/baselines.md` tells why).",
    )
)


@dataclass(frozen=True, eq=False)
class Studied:
    """Everything about a scene that is on the page."""

    evidence: Evidence
    claims: Sequence[Claim]
    pictures: Sequence[Picture]
    kept: Mapping[str, str]
    """How many people the paper's preprocessing keeps, as text."""
    areas: Mapping[str, str]
    """What clustering finds with the settings of the paper and of the scene, as text."""
    longest_s: float
    """Length of the longest observed stretch, seconds."""

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.evidence.scene


class Verdicts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The verdicts of a scene's page, which the overview repeats."""

    schema: int
    scene: str
    title: str
    verdicts: list[tuple[str, str]]
    """Claims and verdicts, in the order of the page."""

    @classmethod
    def of(cls, studied: Studied) -> "Verdicts":
        """Those of a studied scene."""
        verdicts = [(claim.title, claim.verdict) for claim in studied.claims]
        scene = studied.scene
        return cls(schema=SCHEMA, scene=scene.id, title=scene.title, verdicts=verdicts)


def overview(scenes: Sequence[Verdicts]) -> str:
    """The page of all scenes in Markdown: which claims hold where."""
    by_title = [dict(each.verdicts) for each in scenes]
    titles = dict.fromkeys(title for verdicts in by_title for title in verdicts)
    head = ["claim", *(f"[{each.scene}](paper/{each.scene}.md)" for each in scenes)]
    lines = [[t, *(verdicts.get(t, NOTHING) for verdicts in by_title)] for t in titles]
    return flowed(f"""# The founding paper, claim by claim

*Whenever, Wherever* (Kreutz, Mühlhäuser and Sanchez Guinea, ICRA 2025) models when people enter by
neural temporal point processes, where they enter and where they go by Gaussian areas, and moves
them by behaviour cloning. These pages check its claims with its own models and settings, and with
crowdbench’s. The page of a scene, `docs/paper/SCENE.md`, has the numbers and pictures behind the
verdicts. It is made by `python -m studies paper SCENE`, as is this overview.

Most [models that engineers use](peers.md) walk better on ETH than behaviour cloning as in the
paper.

## Which claims hold

{table(head, lines, text=len(head))}

The models, which are all fitted to the whole recording:

{_MODELS}

As in the paper, the {SAMPLES} samples of its models are from one fit: a difference can be one of
that fit. Those of `ntpp-gmm` are from {SAMPLES} fits with different seeds. If nothing else is said,
training windows have 1000 frames with a stride of 50, as in the published code, except that shipped
fits of `ntpp-gmm` have 100 and 50. All models use the areas of the scene, and everyone is kept. A
difference is significant if Welch’s t-test over the samples says so at 5 %, with Holm’s procedure
over the tests of a claim. ± is the standard deviation over samples.

To check the claims with the people and areas of the paper:

```sh
crowdbench scene fit eth-v0 --preprocess paper --clustering paper --out results/eth-as-in-the-paper
python -m studies paper results/eth-as-in-the-paper --out results/paper
```
""")


def page(studied: Studied, commit: str) -> str:
    """The page of a scene in Markdown; the same samples give the same bytes."""
    scene = studied.scene
    made = f"crowdbench {__version__}{commit and f' (commit {commit})'}"
    took_s = training_s([studied.evidence])
    took = f"{digits(took_s / 3600)} hours" if took_s >= 3600 else f"{took_s / 60:.0f} minutes"
    return flowed(f"""# The founding paper on {scene.id}: {scene.title}

Generated with {made} by

```sh
{shlex.join(["python", "-m", "studies", "paper", named(scene)])}
```

The fits took {took} of one core. They are kept: an interrupted command continues. [The founding
paper, claim by claim](../paper.md) tells which models are compared, and how. {of_recording(scene)}

{_sections(studied)}
""")


def _sections(studied: Studied) -> str:
    of = studied.evidence
    scene = of.scene
    left = {picture.file: picture for picture in studied.pictures}
    parts = []
    for claim in studied.claims:
        if not claim.why:  # it is about another scene
            continue
        verdict = "" if claim.verdict == NOTHING else f"{claim.verdict.capitalize()}. "
        parts.append(f"## {claim.title}\n\n{verdict}{claim.why}")
        parts += [_shown(scene, left.pop(file)) for file in claim.pictures if file in left]
    parts += [
        "## Arrivals",
        f"Means, and ranges of 95 % of {SAMPLES * DRAWS} samples of the arrivals alone.",
        arrivals(of),
        "## Do samples follow the density that was trained?",
        "If they do, time-rescaled gaps are uniform. *agrees*: the smallest of the p-values of "
        f"the {SAMPLES} samples, times {SAMPLES}, is above 5 %.",
        own_density(of),
        "## Windows and strides",
        "The settings of the paper’s Table I and Fig. 7.",
        windows_and_strides(of),
        _notes(studied),
    ]
    parts += [f"## {p.title}\n\n{_shown(scene, p)}" for p in left.values()]
    parts += [
        "## Who is left out",
        "The paper drops people who hardly move, and those with few or many steps "
        "(`crowdbench scene fit --preprocess paper`); crowdbench keeps everyone.",
        table(["", "people"], [[name, what] for name, what in studied.kept.items()], text=2),
        "## Areas",
        "What DBSCAN finds with each of the scene’s settings; *paper* are those of the paper "
        "(`crowdbench scene fit --clustering paper`).",
        table(["clustering", "areas"], [[n, what] for n, what in studied.areas.items()], text=2),
    ]
    return "\n\n".join(parts)


def _shown(scene: Scene, picture: Picture) -> str:
    return f"![{picture.title}]({scene.id}/{picture.file})\n\n{picture.caption}"


def _notes(studied: Studied) -> str:
    scene = studied.scene
    whole, tenth = (f"{-(-scene.recording.frames // scheme):,} frames" for scheme in SCHEMES)
    notes = [
        "*w/o* means training windows of w frames with a stride of o frames. N is the number of "
        f"people present, with straight walkers. A sample is {SCHEMES[0]} rollout as long as the "
        f"recording ({whole}) and, separately, {SCHEMES[1]} rollouts of a tenth of it ({tenth}), "
        "which are pooled. *distance* is the Wasserstein-1 distance between the distributions of N "
        "of crowd and recording, divided by the recording’s mean. The state of ntpp-gmm’s networks "
        "is reset after a silence of 100 frames, whatever the window. *nats per person*: "
        "log-likelihood of the training arrivals; that of ntpp-paper is a lower bound, which is "
        "low for the published code, as it loses all but one of the people who enter in a frame. "
        "Training times are those of one core of the machine that generated this page."
    ]
    frames = round(studied.longest_s / scene.dt_s)
    cut = sorted({c.window_frames for c in windowed() if c.window_frames >= frames})
    if cut:
        notes.append(
            f"The longest stretch of observed time has {frames:,} frames: windows of "
            f"{' and '.join(map(str, cut))} frames contain at most a whole stretch. Those of the "
            "published code are cut there too, but count as if they were observed in full."
        )
    steps = scene.grid_s / scene.dt_s
    strides = sorted({c.stride_frames for c in windowed()})
    rounded = {o: round(max(1, round(o / steps)) * steps, 6) for o in strides}
    changed = [f"{o} frames become {r:g}" for o, r in rounded.items() if r != o]
    if changed:
        notes.append(
            f"Strides are rounded to the annotation grid of {scene.grid_s:g} s: "
            f"{', '.join(changed)}."
        )
    return " ".join(notes)
