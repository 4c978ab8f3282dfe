"""The fits that scenes ship: as many people as recorded, better than Poisson, and made by `fit`."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from crowdbench import registry
from crowdbench.data.blocks import SPLITS
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError, WeightsError
from crowdbench.progress import heard_by
from crowdbench.registry import DEFAULT_FITS, recording, spawn_model
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.fit import fit_scene
from crowdbench.spawn import Arrivals, NtppGMM, NtppPaper, arrivals_of, fit_areas
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.ntpp import training as ntpp_training
from crowdbench.spawn.ntpp.model import SHAPES

PLAZA, ETH = load_scene("plaza-v0"), load_scene("eth-v0")
FITS = PLAZA.protocol.fits
FRAMES = 25


class Case:
    """A scene with its recording, and the arrivals that each split was fitted to."""

    def __init__(self, scene: Scene, crowd: Trajectories) -> None:
        self.scene = scene
        _, self.crowd = fit_areas(crowd, scene, scene.clustering["default"])
        self.blocks = blocks_of(self.crowd, scene)
        self.areas = len(read_areas(scene).spawn)

    def arrivals(self, split: str, scored: bool = False) -> Arrivals:
        blocks = self.blocks.scored(split) if scored else self.blocks.training(split)
        return arrivals_of(self.crowd, blocks, self.areas)


@pytest.fixture(scope="module")
def plaza() -> Case:
    return Case(PLAZA, recording("plaza"))


@pytest.fixture(scope="module")
def eth(opentraj: Path) -> Case:
    return Case(ETH, read_published(SOURCES["eth"], opentraj))


@pytest.fixture(scope="module", params=["plaza", "eth"])
def case(request: pytest.FixtureRequest) -> Case:
    found: Case = request.getfixturevalue(request.param)
    return found


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("name", DEFAULT_FITS)
def test_samples_have_the_recorded_persons_per_minute_and_area_from_the_first_frames_on(
    case: Case, name: str, split: str
) -> None:
    arrivals, scene = case.arrivals(split), case.scene
    count, early, samples = np.zeros(case.areas), 0, 0
    for fit in range(FITS):
        model = spawn_model(name, scene, split, fit)
        for seed in range(20):
            events = model.sample(scene.horizon_s, scene, np.random.default_rng([fit, seed]))
            count += np.bincount(events.spawn_area, minlength=case.areas)
            early += int((events.time_s < FRAMES * scene.dt_s - 1e-9).sum())
            samples += 1
    recorded = np.bincount(arrivals.area, minlength=case.areas) / arrivals.exposure_s()
    sampled = count / samples / scene.horizon_s
    # On the plaza counts vary more: so do those of the 44 hours by which a network is calibrated.
    near = 0.2 if scene is PLAZA else 0.1
    assert sampled.sum() == pytest.approx(recorded.sum(), rel=near)
    often = np.bincount(arrivals.area, minlength=case.areas) >= 30
    np.testing.assert_allclose(sampled[often], recorded[often], rtol=near)
    # An area of a few people: groups make its count vary by at most about five times its mean.
    error = np.sqrt(5 * recorded / samples / scene.horizon_s)
    assert (np.abs(sampled - recorded)[~often] < 4 * error[~often]).all()
    # The first frames must be no burst: with a group in every area they would have 2 to 3 times.
    # A network begins without a past, which on the plaza means that it is calm.
    per_frame = early / samples / FRAMES / scene.dt_s
    assert per_frame == pytest.approx(sampled.sum(), rel=0.45 if scene is PLAZA else 0.3)


@pytest.mark.parametrize("name", ["poisson-groups", "renewal-gmm", "ntpp-gmm"])
def test_fits_explain_what_they_have_not_seen_better_than_poisson(case: Case, name: str) -> None:
    for split in SPLITS[1:]:
        held_out = case.arrivals(split, scored=True)
        poisson = spawn_model("poisson-gmm", case.scene, split).log_likelihood(held_out)
        for fit in range(FITS):
            found = spawn_model(name, case.scene, split, fit).log_likelihood(held_out)
            assert found > poisson + 0.4


@pytest.mark.long
@pytest.mark.parametrize(("split", "seed"), [("full", 0), ("fold1", 3)])
def test_another_training_gives_the_shipped_likelihood(case: Case, split: str, seed: int) -> None:
    # Torch's last bits differ between machines, and training amplifies them a little.
    arrivals = case.arrivals(split)
    areas = read_areas(case.scene)
    again = ntpp_training.fit(arrivals, areas, case.scene, seed=seed)
    shipped = spawn_model("ntpp-gmm", case.scene, split, seed)
    assert again.log_likelihood(arrivals) == pytest.approx(
        shipped.log_likelihood(arrivals), abs=0.005
    )


def test_the_fits_of_a_part_differ() -> None:
    areas = read_areas(PLAZA)
    weights = [NtppGMM.read(PLAZA, areas, "full", fit).weights for fit in range(FITS)]
    for name in ("state_weight", "base"):
        assert len({w[name].tobytes() for w in weights}) == FITS


def test_a_fold_is_fitted_without_its_scored_blocks(plaza: Case) -> None:
    # The rate of each split is that of its own training blocks.
    for split in SPLITS:
        arrivals = plaza.arrivals(split)
        count = np.bincount(arrivals.area, minlength=plaza.areas)
        model = registry.spawn_model("poisson-gmm", PLAZA, split)
        np.testing.assert_allclose(model.rate, count / arrivals.exposure_s())  # type: ignore[union-attr]


def with_fits(fits: int) -> Scene:
    """The plaza with another protocol."""
    return replace(PLAZA, protocol=structs.replace(PLAZA.protocol, fits=fits))


BRIEF = {"epochs": 3, "patience": 1, "calibration_points": 2000}


@pytest.mark.usefixtures("unadjusted")
def test_neural_fits_are_made_for_every_part_and_told_of(plaza: Case, tmp_path: Path) -> None:
    told: list[tuple[str, int, int | None]] = []
    with heard_by(lambda *of: told.append(of)):
        found = fit_scene(
            with_fits(2),
            plaza.crowd,
            models=["ntpp-gmm"],
            training=BRIEF,
            out=tmp_path,
            workers=1,
        )
    assert [of for of in told if of[0] == "fits"] == [("fits", k, 8) for k in range(9)]
    assert "nats per person" in found["ntpp-gmm"]
    place, areas = replace(PLAZA, folder=tmp_path), read_areas(PLAZA)
    for split in SPLITS:
        one, two, round_again = (NtppGMM.read(place, areas, split, k) for k in range(3))
        assert not np.array_equal(one.weights["base"], two.weights["base"])
        assert all(np.array_equal(one.weights[n], round_again.weights[n]) for n in SHAPES)


@pytest.mark.nightly
@pytest.mark.usefixtures("unadjusted")
def test_two_workers_write_what_one_writes(plaza: Case, tmp_path: Path) -> None:
    for workers in (1, 2):
        out = tmp_path / str(workers)
        fit_scene(with_fits(1), plaza.crowd, training=BRIEF, out=out, workers=workers)
    one, two = (
        {path.name: path.read_bytes() for path in (tmp_path / str(workers)).iterdir()}
        for workers in (1, 2)
    )
    assert len(one) == 9
    assert one == two


@pytest.mark.usefixtures("unadjusted")
def test_without_torch_nothing_is_done_and_the_way_out_is_said(
    plaza: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(SettingError, match=r"pip install.*\[fit\]"):
        fit_scene(PLAZA, plaza.crowd, out=tmp_path)
    assert list(tmp_path.iterdir()) == []
    fit_scene(PLAZA, plaza.crowd, out=tmp_path, models=["poisson-gmm"])
    assert (tmp_path / "poisson-gmm.json").exists()


def written(folder: Path) -> dict[str, bytes]:
    """The files in a folder, which are then marked so that a change of them shows."""
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    for path in folder.iterdir():
        os.utime(path, (0, 0))
    return found


def touched(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.stat().st_mtime > 0}


@pytest.mark.usefixtures("unadjusted")
def test_only_what_is_asked_for_is_written(plaza: Case, tmp_path: Path) -> None:
    place, crowd = replace(PLAZA, folder=tmp_path), recording("plaza")
    shutil.copy(PLAZA.folder / "scene.toml", tmp_path)
    shared = {"scene.toml", "areas.json", "reference.json.gz", "plans.json"}
    fit_scene(place, crowd, models=())
    assert set(written(tmp_path)) == shared
    fit_scene(place, crowd, models=["poisson-gmm"])
    assert touched(tmp_path) == {"poisson-gmm.json"}
    files = written(tmp_path)
    fit_scene(place, crowd, models=["poisson-groups", "poisson-gmm"])  # plans have its times
    assert touched(tmp_path) == {"poisson-gmm.json", "poisson-groups.json", "plans.json"}
    assert (tmp_path / "poisson-gmm.json").read_bytes() == files["poisson-gmm.json"]
    other = tmp_path / "other"  # without areas, which come first
    fit_scene(place, crowd, models=["poisson-gmm"], out=other)
    assert set(written(other)) == shared | {"poisson-gmm.json"}


def test_a_fit_does_not_join_the_areas_of_other_settings(tmp_path: Path) -> None:
    shutil.copy(PLAZA.folder / "areas.json", tmp_path)
    shutil.copy(PLAZA.folder / "scene.toml", tmp_path)
    broad = structs.replace(PLAZA.clustering["default"], spawn_eps_m=30.0, widest_m=np.inf)
    place = replace(PLAZA, folder=tmp_path, clustering={"default": broad})
    with pytest.raises(WeightsError, match=r"areas\.json: got values that do not follow"):
        fit_scene(place, recording("plaza"), models=["poisson-gmm"])
    assert not (tmp_path / "poisson-gmm.json").exists()


def test_models_that_nobody_fits_are_refused(plaza: Case, tmp_path: Path) -> None:
    with pytest.raises(
        SettingError, match="one or more of poisson-gmm, poisson-groups, renewal-gmm, ntpp-gmm"
    ):
        fit_scene(PLAZA, plaza.crowd, out=tmp_path, models=["replay"])


@pytest.mark.usefixtures("unadjusted")
def test_the_papers_models_are_fitted_as_asked(plaza: Case, tmp_path: Path) -> None:
    asked = {"window_frames": 100, "stride_frames": 100, "epochs": 2, "published_code": True}
    fit_scene(
        PLAZA,
        plaza.crowd,
        models=["ntpp-paper", "poisson-paper"],
        training=asked,
        fits=1,
        out=tmp_path,
        workers=1,
    )
    place = replace(PLAZA, folder=tmp_path)
    for split in SPLITS:
        model = NtppPaper.read(place, read_areas(PLAZA), split)
        assert model.published_code
        assert model.settings == asked | {"learning_rate": 5e-3}
        events = registry.spawn_model("poisson-paper", place, split).sample(
            100.0, PLAZA, np.random.default_rng(0)
        )
        assert len(events) > 0


@pytest.mark.parametrize(
    ("models", "training", "told"),
    [
        (["poisson-gmm"], {"epochs": 3}, r"none without a neural model[\s\S]*--models ntpp-gmm"),
        (["ntpp-gmm"], {"published_code": True}, r"got published_code[\s\S]*Only ntpp-paper has"),
        (["ntpp-paper"], {"shared": True}, r"got shared[\s\S]*Only ntpp-gmm has it"),
        (["ntpp-paper"], {"epochs": 0}, "epochs: got 0; expected a positive number"),
        (["ntpp-paper"], {"learning_rate": np.nan}, "learning_rate: got nan"),
    ],
)
def test_training_that_a_model_does_not_have_is_refused(
    plaza: Case, tmp_path: Path, models: list[str], training: dict[str, float], told: str
) -> None:
    with pytest.raises(SettingError, match=told):
        fit_scene(PLAZA, plaza.crowd, models=models, training=training, out=tmp_path)
