"""Which radius bodies have, by what recordings say: who walks closer, and what walking loses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np
from scipy.spatial import KDTree

import crowdbench
from crowdbench.data.table import Trajectories
from crowdbench.metrics import FAMILIES
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.ranking import rows
from studies.markdown import flowed, table

RADII_M = (0.1, 0.15, 0.175)
KEPT = 0.97
"""Bodies fit a recording if people who walk as recorded keep at least this share of each score."""
TITLE = """# Bodies: which radius, and where

With `body_radius_m` in `scene.toml`, people have bodies: discs that pass neither through each other
nor through walls ([the environment](environment.md)). Two questions decide the radius.

**Do recorded people walk closer?** The first table has the share of recorded positions nearer than
two radii to somebody, in percent, for strangers and companions. On ETH, Hotel and Zara nearly
nobody is nearer than 0.3 m. In Grand Central the share hardly falls with the radius: heads were
annotated by hand in a deep hall, and lie on each other at any radius. In the Forum people were
tracked, and tracks of people who meet merge.

**Does walking lose by it?** The second table has the scores of recorded people who walk along their
paths under the rules of the simulation (`recorded-paths`), with bodies as a share of those without.
Where each family keeps at least 97 %, bodies fit the recording. Elsewhere recorded people walk
closer to each other than bodies can. So people have bodies of 0.15 m in eth-v0, hotel-v0 and
zara1-v0, and no bodies in gc-v0, forum-v0 and plaza-v0.

This page is the output of `python -m studies bodies`."""


def page(scenes: Sequence[str]) -> str:
    """The page as Markdown."""
    places = [load_scene(name) for name in scenes]
    close = [
        [f"{radius:g}", *(_shares(crowdbench.recording_of(place), radius) for place in places)]
        for radius in RADII_M
    ]
    lost = []
    for place in places:
        without = scores(with_radius(place, 0.0))
        for radius in RADII_M:
            with_bodies = scores(with_radius(place, radius))
            kept = {family: with_bodies[family] / without[family] for family in without}
            lost.append(
                [
                    place.id,
                    f"{radius:g}",
                    *(f"{kept[f]:.3f}" if f in kept else "–" for f in FAMILIES),
                    f"{min(kept.values()):.3f}",
                    "yes" if min(kept.values()) >= KEPT else "no",
                ]
            )
    first = table(["radius, m", *(place.id for place in places)], close)
    second = table(["scene", "radius, m", *FAMILIES, "least", "fit"], lost)
    return f"{flowed(TITLE)}\n{first}\n\n{second}\n"


def with_radius(scene: Scene, radius_m: float) -> Scene:
    """The scene with bodies of another radius."""
    return replace(scene, motion=msgspec.structs.replace(scene.motion, body_radius_m=radius_m))


def close_rows(crowd: Trajectories, distance_m: float) -> tuple[float, float]:
    """Shares of positions nearer than a distance to a stranger, and to a companion."""
    frame, person = crowd.row_frame(), crowd.row_person()
    order = np.argsort(frame, kind="stable")
    strange, companion = np.zeros(len(frame), bool), np.zeros(len(frame), bool)
    for at in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        pairs = KDTree(crowd.xy[at]).query_pairs(distance_m, output_type="ndarray")
        if len(pairs) == 0:
            continue
        i, j = at[pairs[:, 0]], at[pairs[:, 1]]
        group = crowd.group[person]
        together = (group[i] >= 0) & (group[i] == group[j])
        for of, chosen in ((companion, together), (strange, ~together)):
            of[i[chosen]] = of[j[chosen]] = True
    return float(strange.mean()), float(companion.mean())


def scores(scene: Scene) -> Mapping[str, float]:
    """Scores by family of recorded people who walk in the scene."""
    walked = crowdbench.rollout(scene, "replay", "recorded-paths", seed=0)
    card = crowdbench.score_rollouts(scene.folder, [walked], recorded_arrivals=True)
    return {family: score.value for family, score in rows(card)[0].families.items()}


def _shares(crowd: Trajectories, radius_m: float) -> str:
    return " / ".join(f"{100 * share:.2f}" for share in close_rows(crowd, 2 * radius_m))
