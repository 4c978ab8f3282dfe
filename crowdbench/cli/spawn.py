"""`crowdbench spawn`: spawn areas, samples, tests and scenarios of spawn models."""

from pathlib import Path
from typing import TYPE_CHECKING

import crowdbench
from crowdbench.cli.options import SceneName
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import find_own_code, new_app
from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_note, print_table

if TYPE_CHECKING:
    from crowdbench.report.steering.changes import AreaChange, Steering

app = new_app("spawn", "Spawn models: their areas, samples and tests, and scenarios.")
_LEAST = 0.005  # smallest share of people for which a goal is listed


@app.command
def areas(scene: SceneName, /, *, out: Path | None = None) -> None:
    """List a scene's spawn and goal areas by number.

    Args:
        out: PNG file; also draw a map of the areas
    """
    from crowdbench.files import replacing
    from crowdbench.registry import fitted_models
    from crowdbench.report.steering.pictures import areas_picture
    from crowdbench.spawn import PoissonGMM
    from crowdbench.spawn.ntpp.model import networks

    place = crowdbench.load_scene(scene)
    model = crowdbench.spawn_model("poisson-gmm", place)
    assert isinstance(model, PoissonGMM)
    found, per_minute = model.areas, 60 * model.rate
    fits = networks(place, found, ["full"]) if "ntpp-gmm" in fitted_models(place) else None
    rows = []
    for k, (x, y) in enumerate(found.spawn.mean):
        by_share = sorted(range(len(found.goal)), key=lambda g: (-found.flow[k, g], g))
        likely = [g for g in by_share[:4] if found.flow[k, g] >= _LEAST]
        shown = ", ".join(f"{g} ({100 * found.flow[k, g]:.0f})" for g in likely)
        trained = "–" if fits is None else f"{fits[:, k].sum()} of {len(fits)}"
        rows.append((f"{k}", f"{x:.1f}, {y:.1f}", f"{per_minute[k]:.2f}", trained, shown))
    heads = ("centre (m)", "persons/min")
    print_table("spawn area", *heads, "networks", "goals (%)", rows=rows, left=("goals (%)",))
    if fits is not None:
        print_note(
            "networks: number of ntpp-gmm fits that have a trained network for this area; without "
            "one, groups enter at a constant rate."
        )
    at_goal = per_minute @ found.flow
    goals = zip(found.goal.mean, at_goal, strict=True)
    print_table(
        "goal area",
        *heads,
        rows=[(f"{g}", f"{x:.1f}, {y:.1f}", f"{n:.2f}") for g, ((x, y), n) in enumerate(goals)],
    )
    if out is not None:
        with replacing(out) as temporary:
            temporary.write_bytes(areas_picture(place, found))
        print(f"written to {out}")


@app.command
def sample(
    scene: SceneName,
    /,
    *,
    out: Path,
    model: str = "ntpp-gmm",
    seed: int = 0,
    horizon_s: float | None = None,
) -> None:
    """Write a sample of a spawn model, for other simulators: who enters when, where and whereto.

    Args:
        out: CSV, Parquet or JSON file to write
        model: spawn model, as in `crowdbench evaluate --spawn`
        seed: random seed
        horizon_s: length in seconds (default: that of the recording)
    """
    from crowdbench.registry import GENERATED
    from crowdbench.run.episode import arrivals, check_horizon
    from crowdbench.spawn.export import write_arrivals
    from crowdbench.spawn.names import replays
    from crowdbench.spawn.steering.scenario import split_scenario

    find_own_code()
    place = crowdbench.load_scene(scene)
    if seed < 0:
        raise SettingError("--seed", got=f"{seed}", expected="0 or more")
    if horizon_s is not None:
        check_horizon(horizon_s)
    made = crowdbench.spawn_model(model, place)
    frames = place.recording.frames if horizon_s is None else place.frames(horizon_s)
    events = arrivals(made, place, seed=seed, world=0, warm_up=0, frames=frames)
    write_arrivals(events, place, out, frames=frames)
    print(f"written to {out}: {len(events)} people of {made.name}, {frames * place.dt_s:g} s")
    copied = replays(model) or split_scenario(model)[0] == "block-replay"
    if copied and place.recording.name not in GENERATED:
        print_note("The recording remains subject to its owners' terms: do not publish this file.")


@app.command
def test(scene: SceneName, /) -> None:
    """Test a scene's spawn models: likelihoods, and time rescaling of gaps and group sizes."""
    from crowdbench.scene_building.spawn_diagnostics import check_models, trained_networks
    from crowdbench.spawn.times.groups import KolmogorovSmirnov

    def ks(found: KolmogorovSmirnov | None) -> str:
        return "" if found is None else f"{found.statistic:.3f} ({found.p:.2g})"

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3f}"

    place = crowdbench.load_scene(scene)
    found = list(check_models(place))
    heads = ("full", "held out", "fresh", "persons", "first 25 frames")
    rows = [
        (c.model, *map(number, (c.full, c.heldout, c.fresh, c.persons, c.first))) for c in found
    ]
    print_table("nats per person", *heads, rows=rows)
    print_note(
        "Log-likelihood of the arrivals per area and grid point, in nats per person, averaged over "
        "the fits. full: of the recording. held out: of each fold, by models fitted to the other "
        "folds. fresh: of ten new hours, where the true process is known. persons: sampled people "
        "per recorded person. first 25 frames: arrivals relative to the average."
    )
    rows = [
        (c.model, *map(ks, (c.gaps, c.sizes, c.own_gaps, c.own_sizes)))
        for c in found
        if c.gaps is not None
    ]
    print_table("KS (p)", "gaps", "group sizes", "own gaps", "own sizes", rows=rows)
    print_note(
        "Time rescaling: Kolmogorov-Smirnov statistic of the recorded gaps between arrivals and of "
        "group sizes under each model. own: the same for ten hours of the model's own samples. A "
        "small p indicates a misfit."
    )
    if any(c.model == "ntpp-gmm" for c in found):
        print_note(str(trained_networks(place)))


@app.command
def steer(
    scene: SceneName,
    scenario: Path,
    /,
    *,
    spawn: str = "ntpp-gmm",
    policy: str = "straight",
    seeds: int | None = None,
    out: Path = Path("results/steering"),
) -> None:
    """Show what a scenario changes in a scene's crowd, and what it does not.

    Args:
        scenario: TOML file of the scenario
        spawn: spawn model
        policy: policy that moves the people
        seeds: number of episodes (default: as in the scene's protocol)
        out: output folder of the pictures
    """
    from crowdbench.report.steering.changes import steering
    from crowdbench.report.steering.pictures import draw_steering

    find_own_code()
    found = steering(scene, scenario, spawn=spawn, seeds=seeds)
    _print_changes(found)
    with progress_bar("rollouts") as progress:
        paths = draw_steering(found, out, policy=policy, progress=progress)
    print(f"written to {out}: {' and '.join(path.name for path in paths)}")


def _print_changes(found: "Steering") -> None:
    from crowdbench.report.steering.changes import area_changes, goal_changes

    episodes = len(found.models)
    print(
        f"\n{found.models[0].name} on {found.scene.id}: persons per episode of "
        f"{found.scene.horizon_s:.0f} s, mean of {episodes} episode{'s' * (episodes != 1)}"
    )
    heads = ("centre (m)", "as fitted", "asked for", "steered")
    rows = [(*_cells(a), _share(a.same_entry), _share(a.same_goal)) for a in area_changes(found)]
    print_table("spawn area", *heads, "same entry", "same goal too", rows=rows)
    print_note(
        "same entry: share of the people of the fitted model who also enter under the scenario, "
        "at exactly the same time and place and with the same speed. same goal too: those who "
        "also have the same goal."
    )
    print_table("goal area", *heads, rows=map(_cells, goal_changes(found)))


def _cells(change: "AreaChange") -> tuple[str, ...]:
    x, y = change.centre_m
    numbers = (change.usual, change.asked, change.steered)
    return (f"{change.area}", f"{x:.1f}, {y:.1f}", *(f"{n:.1f}" for n in numbers))


def _share(value: float | None) -> str:
    """Share as a percentage; `none` and `all` for exactly 0 and 1, `–` for None."""
    if value is None:
        return "–"
    return {0.0: "none", 1.0: "all"}.get(value, f"{100 * value:.1f} %")
