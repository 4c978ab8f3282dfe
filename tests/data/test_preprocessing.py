"""The paper's preprocessing: who is dropped, and that nothing else changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of, crowds

from crowdbench.data.preprocessing import only, paper_preprocessed
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.registry import raw_recording_of, recording, recording_of
from crowdbench.scene import load_scene
from crowdbench.scene_building.fit import fit_scene


def walkers(*of: tuple[int, float]) -> Trajectories:
    """People who walk straight on, with these numbers of steps and distances from start to end."""
    paths = [
        np.stack([np.linspace(0, far, steps + 1), np.zeros(steps + 1)], 1) for steps, far in of
    ]
    return crowd_of([(1, steps + 1) for steps, _ in of], xy=np.concatenate(paths), frames=130)


def test_each_rule_drops_whom_it_should() -> None:
    crowd = walkers((20, 9.0), (19, 9.0), (98, 9.0), (99, 9.0), (50, 1.41), (50, 1.42))
    kept, counts = paper_preprocessed(crowd)
    assert kept.person_id.tolist() == [crowd.person_id[k] for k in (0, 2, 5)]
    assert [int(text.split()[0]) for text in counts.values()] == [6, 5, 4, 3, 4]
    twice = replace(crowd, grid_s=2 * crowd.dt_s)
    code = paper_preprocessed(twice)[1]["published code"]
    assert code.startswith("5 ")  # 99 steps are 50 annotated positions


@given(crowds(), st.integers(0, 2**31))
def test_the_others_stay_as_they_were(crowd: Trajectories, seed: int) -> None:
    chosen = np.random.default_rng(seed).random(len(crowd)) < 0.5
    kept = only(crowd, chosen)
    assert (kept.frames, kept.provenance) == (crowd.frames, crowd.provenance)
    np.testing.assert_array_equal(kept.observed, crowd.observed)
    for new, old in enumerate(np.flatnonzero(chosen).tolist()):
        np.testing.assert_array_equal(kept.path(new), crowd.path(old))
        for name in ("person_id", "first", "spawn_area", "group", "goal_x", "left", "requested_s"):
            assert getattr(kept, name)[new] == getattr(crowd, name)[old]


def test_the_papers_number_on_eth_is_met(opentraj: Path) -> None:
    kept, counts = paper_preprocessed(read_published(SOURCES["eth"], opentraj))
    assert len(kept) == 258
    assert counts["not too long"].startswith("258 ")


@pytest.mark.usefixtures("unadjusted")
def test_a_preprocessed_scene_has_the_others_only(tmp_path: Path) -> None:
    plaza, crowd = load_scene("plaza-v0"), recording("plaza")
    with pytest.raises(SettingError, match="no output folder"):
        fit_scene(plaza, crowd, preprocess="paper", models=())
    facts = fit_scene(plaza, crowd, preprocess="paper", models=(), out=tmp_path)
    scene = load_scene(tmp_path)
    assert scene.recording.preprocess == "paper"
    kept, counts = paper_preprocessed(crowd)
    assert 0 < len(kept) < len(crowd)
    assert facts["persons"].startswith(f"{len(kept)},")
    assert facts["not too long"] == counts["not too long"]
    assert len(raw_recording_of(scene)) == len(recording_of(scene)) == len(kept)
    # Fitting the new scene again drops the same people.
    again = fit_scene(scene, crowd, models=())
    assert again["persons"] == facts["persons"]
    assert len(recording_of(plaza)) == len(crowd)
