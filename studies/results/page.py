"""The Markdown text of a scene's results page."""

import shlex
from collections.abc import Mapping, Sequence

from crowdbench.data.recordings.catalogue import source
from crowdbench.errors import SettingError
from crowdbench.report.text.words import PROTOCOLS, named
from crowdbench.scene import Scene
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.scorecard import Protocol, Scorecard, has_recorded_arrivals
from studies.markdown import flowed
from studies.results.correlations import Lag
from studies.results.misses import LOW, MEMORY, misses, not_scored
from studies.results.pictures import Picture
from studies.results.tables import distance_table, score_table

_NAMES: dict[Protocol, str] = {"full": "Full", "heldout": "Held out"}


def page(
    scene: Scene,
    cards: Mapping[Protocol, Scorecard],
    lags: Mapping[Protocol, Sequence[Lag]],
    pictures: Sequence[Picture],
) -> str:
    """The page in Markdown; the same cards, lags and pictures give the same bytes.

    `lags` are the autocorrelations of each card's best crowd. Pictures are linked in the folder
    `<scene>` beside the page.
    """
    full = cards["full"]
    scores = "\n\n".join(_scores(protocol, card) for protocol, card in cards.items())
    distances = "\n\n".join(
        f"### {_NAMES[protocol]}\n\n{distance_table(card)}" for protocol, card in cards.items()
    )
    words = "\n\n".join(
        f"### {_NAMES[protocol]}\n\n{misses(card, lags[protocol])}"
        for protocol, card in cards.items()
    )
    shown = "\n\n".join(_picture(scene, picture) for picture in pictures)
    return flowed(f"""# {scene.title}: results on {scene.id}

{of_recording(scene)}

{_made(scene, full)}

## Scores

`docs/metrics.md` explains how to read a table of scores. *crowd* is the mean of the families before
it, *walk* the lesser of motion and interaction, *overall* the mean of crowd and walk. Rows in
italics are unranked references: *replay* plays back the recording, *recorded-paths* walks it under
the rules of the simulation, *block-replay* plays back random time blocks.
{_no_walk(full)}

{scores}

## Distances

Plain distances to the recording, mean ± standard deviation over the rollouts (held out: over the
rollouts of all folds); 0 means no difference. They favour crowds that vary too little, and are not
used for ranking. *recorded* is the typical value of the recording: a mean, or the metric itself.
Motion and interaction are scored under the recorded arrivals only, in the columns of replay.

{distances}

## Pictures

The pictures show the whole recording and one rollout of each fit in protocol `full`. Colours mark
spawn models; the recording is black or grey. If both policies are drawn, dashed lines are
social-force.

{shown}

## What the models miss

The *memorisation baseline* is {MEMORY[0]} × {MEMORY[1]}: random time blocks of the recording, in
`full` from the blocks that it is compared with, in `heldout` from the other two folds. Brackets are
95 % intervals of single numbers. Significance is stricter: 5 % by Holm’s procedure over all pairs
of evaluated crowds and the memorisation baseline. Simulated values are means over the rollouts. A
score below {LOW:g} is closer to the anchor’s than to the true process’s. Motion and interaction are
those under the recorded arrivals; straight walkers are their anchor, with a score of 0.

{words}

### What is not scored

{not_scored(full)}
""")


def of_recording(scene: Scene) -> str:
    """Sentences on the recording of a scene, and how to cite it."""
    name = scene.recording.name
    length = f"{scene.horizon_s:,.0f} s in frames of {scene.dt_s:.3g} s"
    if name == "plaza":
        return (
            f"Crowds are compared with the recording of a synthetic scene, {length}. crowdbench "
            "generates it, so there is no paper to cite."
        )
    compared = f"Crowds are compared with the recording `{name}` of this scene, {length}."
    try:
        cite = source(name).cite
    except SettingError:  # a user's own recording
        return compared
    return f"{compared} It remains under its owners’ terms. If you use these results, cite {cite}."


def _made(scene: Scene, card: Scorecard) -> str:
    words = ["python", "-m", "studies", "results", named(scene)]
    if card.rollouts != scene.protocol.fits * scene.protocol.rollouts_per_fit:
        words += ["--seeds", str(card.rollouts)]
    return f"""Generated with crowdbench {card.crowdbench} (scene files `{card.made_from}`) by

```sh
{shlex.join(words)}
```

Rollouts of each crowd: {card.rollouts} in `full` and {card.rollouts} in each of the three folds of
`heldout`, each as long as the recording, from {card.fits} fits of each model. They are compared
with the recording in {card.blocks} time blocks of about {scene.protocol.block_s:g} s. Intervals
come from {card.resamples:,} resamples of blocks, fits and rollouts."""


def _scores(protocol: Protocol, card: Scorecard) -> str:
    return (
        f"### {_NAMES[protocol]}\n\nProtocol `{protocol}`: {PROTOCOLS[protocol]}\n\n"
        f"{score_table(rows(card))}"
    )


def _no_walk(card: Scorecard) -> str:
    if has_recorded_arrivals(card):
        return ""
    return (
        "The recording was not imported, so policies were not run under the recorded arrivals: "
        "only the baselines have walk and overall scores."
    )


def _picture(scene: Scene, picture: Picture) -> str:
    image = f"![{picture.title}]({scene.id}/{picture.file})"
    return f"### {picture.title}\n\n{image}\n\n{picture.caption}"
