"""Scores and ranks of the leaderboard's tracks, honest about ties."""

import msgspec
import numpy as np
import pytest
from entries import everyone, made_up

from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.metrics import WALK
from crowdbench.scoring.score import Score, combined, ranks
from studies.site.standings import TRACKS, standing


def test_scores_combine_families_then_scenes() -> None:
    entry = next(e for e in everyone() if e.id == "ntpp-gmm-bc")
    found = scores(entry)
    each = []
    for name in SCENES:
        families = {f: card.score() for f, card in entry.scenes[name].families.items()}
        crowd = [score for f, score in families.items() if f not in WALK]
        walk = [score for f, score in families.items() if f in WALK]
        assert len(walk) == 2
        value = (np.mean([s.value for s in crowd]) + min(s.value for s in walk)) / 2
        resampled = np.mean([s.resampled for s in crowd], axis=0)
        resampled = (resampled + np.min([s.resampled for s in walk], axis=0)) / 2
        assert found[View(scene=name)].value == pytest.approx(value)
        np.testing.assert_allclose(found[View(scene=name)].resampled, resampled)
        assert found[View("motion", name)].value == families["motion"].value
        each.append(Score(float(value), resampled))
    assert found[View()].value == pytest.approx(np.mean([score.value for score in each]))
    np.testing.assert_allclose(
        found[View()].resampled, np.mean([score.resampled for score in each], axis=0)
    )
    assert found[View("trips")].value == pytest.approx(
        np.mean([entry.scenes[s].families["trips"].value for s in ("gc-v0", "forum-v0")])
    )


@pytest.mark.parametrize("track", TRACKS)
def test_ranks_of_each_view_are_those_of_its_scores(track: str) -> None:
    found = standing(track, everyone())  # type: ignore[arg-type]
    for view in found.views:
        competing = [
            line
            for line in found.lines
            if line.entry.status == "ranked" and view in scores(line.entry)
        ]
        expected = ranks([scores(line.entry)[view] for line in competing])
        names = [line.entry.id for line in competing]
        alone = len(names) == 1
        assert found.ranks[view] == ({} if alone else dict(zip(names, expected, strict=True)))


def test_who_lacks_a_scene_ranks_on_the_others_alone() -> None:
    found = standing("walk", everyone())
    assert "ppo" not in found.ranks[View()]
    assert "ppo" in found.ranks[View(scene="eth-v0")]
    assert "ppo" not in found.ranks[View(scene="forum-v0")]


def test_a_scene_without_a_family_that_counts_there_has_no_score() -> None:
    entry = made_up("half", "walk", 0.5)
    scene = entry.scenes["gc-v0"]
    less = msgspec.structs.replace(scene, families={"motion": scene.families["motion"]})
    scenes = entry.scenes | {"gc-v0": less}
    found = scores(msgspec.structs.replace(entry, scenes=scenes))
    assert View(scene="gc-v0") not in found
    assert View() not in found
    assert View("motion", "gc-v0") in found


def test_crowds_that_came_as_trajectories_are_judged_without_how_people_walk() -> None:
    (line,) = standing("crowd", everyone()).listed
    assert line.kind == "model-based, trajectories"
    each = []
    for name in SCENES:
        families = {f: card.score() for f, card in line.entry.scenes[name].families.items()}
        whole = combined(list(families.values()))
        assert whole is not None
        assert set(families) <= {"arrivals", "presence", "trips", "space"}
        assert line.scores[View(scene=name)].value == pytest.approx(whole.value)
        each.append(whole.value)
    assert line.scores[View()].value == pytest.approx(np.mean(each))
    assert View("motion") not in line.scores
    # A model without these families, or a walk without a family, has no score.
    for entry in (line.entry, made_up("walk", "walk", 0.5)):
        scenes = {
            name: msgspec.structs.replace(
                scene, families={f: c for f, c in scene.families.items() if f != "motion"}
            )
            for name, scene in entry.scenes.items()
        }
        less = msgspec.structs.replace(entry, scenes=scenes, artefacts={"submission.toml": ""})
        assert scores(less).keys() & {View(), *(View(scene=name) for name in SCENES)} == set()


def test_entries_that_cannot_be_told_apart_share_a_rank() -> None:
    found = standing("spawn", everyone())
    by_name = {line.entry.id: found.rank(line, View()) for line in found.lines}
    assert by_name["ntpp-gmm"] == by_name["twin"] == "2\u202f="
    assert by_name["jittered-blocks"] == "1"
    assert by_name["renewal-gmm"] == "4"
    assert by_name["block-replay"] == ""


def test_references_stand_below_all_who_score_as_much() -> None:
    order = [line.entry.id for line in standing("spawn", everyone()).ordered(View())]
    assert order == [
        "jittered-blocks", "ntpp-gmm", "twin", "block-replay", "renewal-gmm", "poisson-gmm",
    ]  # fmt: skip


def test_listed_entries_and_references_do_not_compete() -> None:
    with_all = standing("spawn", everyone())
    alone = standing("spawn", [e for e in everyone() if e.status == "ranked"])
    assert with_all.ranks == alone.ranks


def test_models_of_other_simulators_are_shown_by_score_without_a_rank() -> None:
    others = [made_up(f"ranked-{k}", "walk", 0.2 * k) for k in range(4)]
    external = made_up("external", "walk", 0.5, status="external")
    found = standing("walk", [*others, external])
    names = [line.entry.id for line in found.ordered(View())]
    assert names.index("ranked-3") < names.index("external") < names.index("ranked-1")
    assert all("external" not in ranks for ranks in found.ranks.values())
    (line,) = (line for line in found.lines if line.entry.id == "external")
    assert line.kind == "external"
    assert found.address(line) == "../docs/peers.md"
    assert standing("walk", [external], paged=True).address(line) == "pages/external.html"
    without = standing("walk", others)
    assert without.ranks == found.ranks
