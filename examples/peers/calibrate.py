"""Calibration: choose the parameters of a model on the training blocks of a scene's folds.

The optimiser is the tree-structured Parzen estimator of Optuna (Bergstra et al. 2011), which starts
from the published parameters, with `TRIALS` trials for each model, scene and fold. A trial walks
the people of the recording, and is judged on the training blocks only: see
`crowdbench.run.validation`. What it maximises is the walk score, the lesser of motion and
interaction, less what exceeds the limits of the scene's gate.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import optuna
from optuna.trial import TrialState

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import CrowdbenchError
from crowdbench.files import sha256, write_text
from crowdbench.run.validation import Validation, Validator
from crowdbench.scene import Scene, load_scene

from .calibrated import FILE, known_parameters
from .models import MODELS
from .walk import key_of

TRIALS = 40
FOLDS = SPLITS[1:]
HORIZON_S: Mapping[str, float] = {"gc-v0": 267.0, "forum-v0": 9000.0}
"""Only the first part of long recordings is walked in a trial."""
COSTLY: Mapping[str, Sequence[str]] = {"pysocialforce": ("gc-v0",)}
"""Scenes that are not calibrated: a trial takes minutes."""
OUT = Path("results/peers/calibration")
_WORST = -2.0


def calibrate(
    scenes: Sequence[str],
    models: Sequence[str],
    *,
    out: Path = OUT,
    workers: int = 1,
    trials: int = TRIALS,
) -> None:
    """Calibrate models on scenes, one study of Optuna per model, scene and fold.

    Studies are kept in `out`, where a later call continues them. Each result goes into
    `calibrated.json` when it is complete, and what is in there is not calibrated again.
    """
    out.mkdir(parents=True, exist_ok=True)
    wanted = [
        (model, scene, split)
        for scene in scenes
        for model in models
        if scene not in COSTLY.get(model, ())
        for split in FOLDS
        if split not in known_parameters().get(model, {}).get(scene, {})
    ]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(search, *job, out, trials): job for job in wanted}
        for done, future in enumerate(as_completed(jobs), 1):
            (model, scene, split), (value, first, best) = jobs[future], future.result()
            _record(model, scene, split, best)
            print(
                f"{done} of {len(jobs)}: {model} on {scene}, {split}: {first:.2f} as published, "
                f"{value:.2f} calibrated",
                flush=True,
            )


def search(
    model: str, scene: str, split: str, out: Path, trials: int
) -> tuple[float, float, dict[str, float]]:
    """The best value of a study, that of the published parameters, and the best parameters."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    kind, place = MODELS[model], load_scene(scene)
    key = sha256(f"{key_of(place, kind)} {kind.searched}".encode())[:8]
    study = optuna.create_study(
        study_name=f"{model} {scene} {split}",
        storage=f"sqlite:///{out / f'{model}-{scene}-{split}-{key}.db'}",
        direction="maximize",
        load_if_exists=True,
    )
    study.sampler = optuna.samplers.TPESampler(seed=len(study.trials), multivariate=True)
    if not _published(study):
        published = {name: of.published for name, of in kind.searched.items()}
        study.enqueue_trial(published, user_attrs={"published": True})
    finished = len(study.get_trials(states=[TrialState.COMPLETE]))
    if finished < trials:
        validator = Validator(place, split, horizon_s=HORIZON_S.get(scene))

        def objective(trial: optuna.Trial) -> float:
            parameters = {
                name: trial.suggest_float(name, of.low, of.high, log=of.low > 0)
                for name, of in kind.searched.items()
            }
            try:
                return value_of(validator.validate(kind(parameters)), place)
            except (CrowdbenchError, RuntimeError):  # nobody entered, or the simulator stopped
                return _WORST

        study.optimize(objective, n_trials=trials - finished)
    (first,) = _published(study)
    assert first.value is not None
    return study.best_value, first.value, study.best_params


def _published(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """The trial with the published parameters, if it is complete."""
    complete = study.get_trials(states=[TrialState.COMPLETE])
    return [trial for trial in complete if trial.user_attrs.get("published")][:1]


def value_of(found: Validation, scene: Scene) -> float:
    """What is maximised: the lesser family, less what exceeds the gate."""
    off = abs(found.speed_mps / found.recorded_speed_mps - 1) - scene.gate.speed
    missing = scene.gate.arrivals - found.at_goal
    return min(found.families.values()) - max(0.0, off) - max(0.0, missing)


def _record(model: str, scene: str, split: str, best: Mapping[str, float]) -> None:
    known = known_parameters()
    known.setdefault(model, {}).setdefault(scene, {})[split] = {
        name: float(f"{value:.4g}") for name, value in sorted(best.items())
    }
    in_order = {m: {s: dict(sorted(of.items())) for s, of in sorted(known[m].items())}
                for m in sorted(known)}  # fmt: skip
    told = {"trials": TRIALS, "seconds": dict(HORIZON_S), "parameters": in_order}
    write_text(FILE, json.dumps(told, indent=1) + "\n")
