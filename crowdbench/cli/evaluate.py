"""`crowdbench evaluate` and `score`: compare crowds with a scene's recording."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import crowdbench
from crowdbench.cli.options import EngineName, Json, SceneName, Workers
from crowdbench.cli.printing import json_written, progress_bar
from crowdbench.cli.running import find_own_code
from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_facts, print_note
from crowdbench.run.processes import LOCAL

if TYPE_CHECKING:
    from crowdbench.scoring.scorecard import Scorecard


def evaluate(
    scene: SceneName,
    /,
    *,
    spawn: Sequence[str] | None = None,
    policy: Sequence[str] | None = None,
    metric: Sequence[str] = (),
    scenario: str | None = None,
    protocol: Literal["full", "heldout"] = "full",
    seeds: int | None = None,
    quick: bool = False,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    no_report: bool = False,
    keep_rollouts: bool = False,
    out: Path | None = None,
    view: bool = False,
    json: Json = None,
) -> None:
    """Roll out crowds on a scene and compare them with its recording.

    Args:
        spawn: spawn models: poisson-gmm, poisson-groups, renewal-gmm, ntpp-gmm, cox-gmm, joint-gmm,
            poisson-paper and ntpp-paper (single people); poisson-plans, ntpp-plans, cox-plans and
            ntpp-joint (people with companions and stops); block-replay, replay, perturbed-replay
            (the recorded people a little earlier, later and elsewhere); a folder with the fits of
            one model, or pkg.module:Class (default: poisson-gmm, ntpp-gmm and cox-plans)
        policy: policies: straight, social-force, speed-model, guided-walker, random,
            anticipate-any, replay and recorded-paths (these two with the spawn model replay), those
            that come with the scene, FILE.onnx, a folder with such a file for each fold, or
            pkg.module:Class (default: straight, social-force and anticipate, or guided-walker where
            that does not ship)
        metric: additional metrics of your own, pkg.module:Class (see `crowdbench scene metrics`)
        scenario: TOML file that changes rates, goals and areas of each spawn model without
            retraining
        protocol: full: fit and compare on the whole recording; heldout: compare on the folds that
            were held out from fitting
        seeds: rollouts of each pair of spawn model and policy (in each fold). Scores need at least
            two rollouts per fit. With the usual 5 fits, use 10, 15, 20, …; fewer give only plain
            distances (default: as in the scene's protocol)
        quick: as few rollouts as scores need; intervals are wider. With --policy alone, people
            enter as recorded and only walking is scored; with --spawn alone, people walk straight
        no_report: write the scorecard only, without report.html
        keep_rollouts: write the trajectories of all rollouts, not only of the first ones
        out: output folder (default: results/SCENE-DATE-TIME)
        view: show the first rollout of each pair in the viewer at the end
    """
    from crowdbench.evaluation import default_spawn_models
    from crowdbench.report.text.scorecards import print_card
    from crowdbench.scoring.ranking import score_rows

    find_own_code()
    if view:  # checked before minutes of rollouts
        from crowdbench.viewer import check_screen

        check_screen()
    out = out or Path("results") / f"{Path(scene).name}-{time.strftime('%Y%m%d-%H%M%S')}"
    asked = spawn or (default_spawn_models(crowdbench.load_scene(scene)) if scenario else [])
    with json_written(json) as write:
        with progress_bar("rollouts"):
            card = crowdbench.evaluate(
                scene,
                spawn=[f"{s}+{scenario}" for s in asked] if scenario else spawn,
                policy=policy,
                metric=metric,
                protocol=protocol,
                seeds=seeds,
                quick=quick,
                workers=workers,
                out=out,
                report=not no_report,
                keep_rollouts=keep_rollouts,
            )
        print_card(card, crowdbench.load_scene(scene))
        if any(entry.spawn == entry.policy == "replay" for entry in card.entries):
            _print_replay(scene, out)
        report = "" if no_report else "report.html, "
        print(f"written to {out}: {report}scorecard.json, run.json and rollouts/")
        if view:
            _show_first(card, scene, out)
        write(score_rows(card))


def score(
    scene: SceneName,
    tables: list[Path],
    /,
    *,
    recorded_arrivals: bool = False,
    classifier: bool = False,
    json: Json = None,
) -> None:
    """Compare the trajectories of any simulator with a scene's recording.

    Args:
        tables: CSV or Parquet with person_id, frame (or time_s), x, y; several files are rollouts
            of one simulator and get scores
        recorded_arrivals: people enter at the recorded times and places: score how they walk
            (needs the recording)
        classifier: also print how well a classifier tells people who walk from the recorded ones
            (needs the recording)
    """
    from crowdbench.report.text.notes import missing_notes
    from crowdbench.report.text.scorecards import print_card, print_results
    from crowdbench.scoring.ranking import score_rows
    from crowdbench.scoring.reference import check_fits

    place = crowdbench.load_scene(scene)
    if len({table.resolve() for table in tables}) < len(tables):
        raise SettingError(
            "crowdbench score", got="a file that is named twice", expected="a file for each rollout"
        )
    read_in = [crowdbench.read(table, place) for table in tables]
    for table, crowd in zip(tables, read_in, strict=True):
        check_fits(crowd, place, table)
    if classifier:
        _print_classifier(place, tables, read_in)
    several = len(tables) > 1 or recorded_arrivals
    with json_written(json) as write:
        if several or json is not None:  # a scene of one's own may have no anchors yet
            card = crowdbench.score_rollouts(place, read_in, recorded_arrivals=recorded_arrivals)
            write(score_rows(card))
        if several:
            print_card(card, place)
            return
        print(f"\n{tables[0].name} on {place.id}: {len(read_in[0])} persons")
        print_results(crowdbench.score(place, read_in[0]))
        for note in missing_notes(place):
            print_note(note)


def _print_classifier(
    place: "crowdbench.Scene", tables: list[Path], crowds: "list[crowdbench.Trajectories]"
) -> None:
    from crowdbench.run.references import classifier_test_of

    test = classifier_test_of(place)
    told = [test.auc(crowd) for crowd in crowds]
    none = "no result: too few people who walk, or the classifier tells the recording from itself"
    facts = {
        table.name: none if auc is None else f"{auc.value:.2f} ± {auc.error:.2f}"
        for table, auc in zip(tables, told, strict=True)
    }
    known = [auc for auc in told if auc is not None]
    if known:
        facts["recording (control)"] = f"{known[0].control:.2f}"
    print_facts("AUC of a classifier (0.5: cannot be told from the recording)", facts)


def _print_replay(scene: str, out: Path) -> None:
    from crowdbench.run.replay_check import compare_replay

    place = crowdbench.load_scene(scene)
    recording = crowdbench.recording_of(place)
    walked = crowdbench.read_own(out / "rollouts" / "replay_replay_full_0.parquet")
    print_facts("replay compared with the recording", compare_replay(recording, walked, place))
    print()


def _show_first(card: "Scorecard", named: str, out: Path) -> None:
    """Show the first rollout of each pair, next to the recording if it is available."""
    from crowdbench.registry import has_recording
    from crowdbench.viewer import show

    scene = crowdbench.load_scene(named)
    against = crowdbench.recording_of(scene) if has_recording(scene) else None
    first: dict[tuple[str, str], crowdbench.Trajectories] = {}
    for path in sorted((out / "rollouts").glob("*_0.parquet")):
        crowd = crowdbench.read_own(path)
        first.setdefault((crowd.provenance["spawn"], crowd.provenance["policy"]), crowd)
    for entry in card.entries:
        show(first[entry.spawn, entry.policy], scene, against=against)
