"""The copy index of arrivals: models that cannot copy, and disguised copies of the recording."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.leaderboard.verification.copying import (
    COARSE_S,
    WINDOW_BINS,
    arrival_copies,
    independent_limits,
)
from crowdbench.leaderboard.verification.flags import MARGIN, moved_limit
from crowdbench.registry import recording_of, spawn_model
from crowdbench.run.jobs import DRAWS
from crowdbench.scene import Scene, load_scene
from studies.markdown import flowed, table

MODELS = ("poisson-gmm", "renewal-gmm", "ntpp-gmm", "cox-plans", "block-replay")
MOVED_S = (2.0, 5.0, 10.0, 20.0)
"""Copies: each recorded group enters up to so many seconds earlier or later."""
WARP_S, WARP_PERIOD_S, WARP_MOVED_S = 20.0, 300.0, 5.0

TEXT = """## Copied arrivals

A spawn model can know the recorded arrivals by heart, and move them. The index is the correlation
of arrivals per area with the most similar window of the recording (median over windows): counted in
frames, and in bins of {bins} s in windows of {window} bins. In frames, an index is flagged from
{margin:g} above what 99 % of crowds of `poisson-gmm` and `renewal-gmm` have, which cannot copy; in
bins, from a third of the way from that to 1. The table shows medians over {draws} draws, of models
and of the recorded arrivals with each group moved by up to some seconds. *Warped* moves the whole
recording back and forth by {warp:g} s every {period:g} s, and groups by up to {moved:g} s. Flagged
values are bold."""


class Row(NamedTuple):
    """One model or copy on a scene: its index for each of the bins, and whether it is flagged."""

    name: str
    values: list[float]
    flagged: list[bool]


def moved(
    time_s: Float[np.ndarray, " n"],
    group: Int[np.ndarray, " n"],
    by_s: float,
    horizon_s: float,
    rng: Generator,
) -> Float[np.ndarray, " n"]:
    """Arrival times (s), those of each group moved by up to `by_s`; `group` are numbers from 0."""
    by = rng.uniform(-by_s, by_s, int(group.max(initial=-1)) + 1)
    return np.clip(time_s + by[group], 0.0, horizon_s - 1e-3)


def measured(scene: Scene) -> list[Row]:
    """The index of models and copies on a scene.

    Raises:
        RecordingError: the recording has not been imported.
    """
    copies = arrival_copies(scene.id)
    limits = [limit or 0.0 for limit in independent_limits(scene)]
    limits = [limits[0] + MARGIN, *map(moved_limit, limits[1:])]

    def row(name: str, drawn: Sequence[tuple[np.ndarray, np.ndarray]]) -> Row:
        values = [
            float(np.median([each.index(time_s, area) or 0.0 for time_s, area in drawn]))
            for each in copies.values()
        ]
        return Row(name, values, [i > most for i, most in zip(values, limits, strict=True)])

    found = []
    for model in MODELS:
        fitted = spawn_model(model, scene)
        events = [
            fitted.sample(scene.horizon_s, scene, np.random.default_rng(k)) for k in range(DRAWS)
        ]
        found.append(row(model, [(e.time_s, e.spawn_area.astype(np.int64)) for e in events]))
    recorded = recording_of(scene)
    persons = np.flatnonzero(recorded.entered)
    time_s, area = recorded.spawn_s[persons], recorded.spawn_area[persons].astype(np.int64)
    company = recorded.group[persons]
    alone = int(company.max(initial=0)) + 1 + np.arange(len(company))
    _, group = np.unique(np.where(company < 0, alone, company), return_inverse=True)

    def copy(time_s: np.ndarray, by_s: float) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            (moved(time_s, group, by_s, scene.horizon_s, np.random.default_rng(k)), area)
            for k in range(DRAWS)
        ]

    found += [row(f"recorded, moved by up to {by:g} s", copy(time_s, by)) for by in MOVED_S]
    warp = time_s + WARP_S * np.sin(2 * np.pi * time_s / WARP_PERIOD_S)
    return [*found, row("recorded, warped", copy(warp, WARP_MOVED_S))]


def _cell(value: float, flagged: bool) -> str:
    return f"**{value:.2f}**" if flagged else f"{value:.2f}"


def section(scenes: Sequence[str]) -> str:
    """The section of the page as Markdown."""
    text = TEXT.format(
        bins=", ".join(f"{b:g}" for b in COARSE_S[:-1]) + f" and {COARSE_S[-1]:g}",
        window=WINDOW_BINS, margin=MARGIN, draws=DRAWS,
        warp=WARP_S, period=WARP_PERIOD_S, moved=WARP_MOVED_S,
    )  # fmt: skip
    lines = [
        [scene, row.name, *map(_cell, row.values, row.flagged)]
        for scene in scenes
        for row in measured(load_scene(scene))
    ]
    head = ["scene", "arrivals", "frames", *(f"{b:g} s" for b in COARSE_S)]
    return f"{flowed(text)}\n{table(head, lines, text=2)}"
