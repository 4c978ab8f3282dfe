"""What is said of the fitted models: likelihoods, time rescaling, counts."""

from pathlib import Path

import pytest

from crowdbench.cli import main
from crowdbench.registry import DEFAULT_FITS, import_recording
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building import spawn_diagnostics
from crowdbench.scene_building.spawn_diagnostics import Checked, check_models

HIDDEN = "cox-gmm"


@pytest.fixture(scope="module")
def plaza() -> dict[str, Checked]:
    return {c.model: c for c in check_models(load_scene("plaza-v0"))}


@pytest.fixture(scope="module")
def eth(opentraj: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Checked]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(tmp_path_factory.mktemp("imported")))
        import_recording("eth", opentraj)
        return {c.model: c for c in check_models(load_scene("eth-v0"))}


def test_the_neural_model_comes_near_the_truth_on_fresh_data(plaza: dict[str, Checked]) -> None:
    truth, ntpp = plaza["plaza-truth"].fresh, plaza["ntpp-gmm"].fresh
    assert truth is not None
    assert ntpp is not None
    # It has seen half an hour, that is ten waves: their rates are those of the recording.
    assert truth - 0.12 < ntpp < truth


def test_nothing_explains_fresh_data_better_than_the_truth(plaza: dict[str, Checked]) -> None:
    fresh = {name: c.fresh for name, c in plaza.items()}
    assert max(fresh, key=lambda name: fresh[name] or -99.0) == "plaza-truth"
    assert min(fresh, key=lambda name: fresh[name] or -99.0) == "poisson-gmm"


@pytest.mark.parametrize("model", [name for name in DEFAULT_FITS if name != HIDDEN])
def test_samplers_follow_their_own_density(plaza: dict[str, Checked], model: str) -> None:
    for found in (plaza[model].own_gaps, plaza[model].own_sizes):
        assert found is not None
        assert found.p > 1e-3
        assert found.n > 5000


def test_poissons_gaps_and_sizes_are_not_the_recordings(plaza: dict[str, Checked]) -> None:
    found = plaza["poisson-gmm"]
    assert found.gaps is not None
    assert found.sizes is not None
    assert max(found.gaps.p, found.sizes.p) < 1e-4


def test_a_model_of_hidden_rates_has_no_gaps_to_rescale(plaza: dict[str, Checked]) -> None:
    found = plaza[HIDDEN]
    assert found.gaps is found.sizes is found.own_gaps is found.own_sizes is None
    assert found.fresh is not None
    assert plaza["poisson-groups"].fresh is not None
    assert found.fresh > plaza["poisson-groups"].fresh + 0.1  # it has the waves


def counts_hold(found: dict[str, Checked], first: float) -> None:
    for name in DEFAULT_FITS:
        if name in found:
            assert found[name].persons == pytest.approx(1, abs=0.10), name
            assert found[name].first == pytest.approx(1, abs=first), name


def test_samples_let_in_as_many_as_were_recorded_on_the_plaza(plaza: dict[str, Checked]) -> None:
    assert set(DEFAULT_FITS) < set(plaza)
    # A network begins without a past, which on the plaza means that it is calm.
    counts_hold(plaza, first=0.45)


def test_samples_let_in_as_many_as_were_recorded_at_eth(eth: dict[str, Checked]) -> None:
    counts_hold(eth, first=0.30)
    order = ("ntpp-gmm", "renewal-gmm", "poisson-groups", "poisson-gmm")
    assert sorted(order, key=lambda name: -eth[name].heldout) == list(order)
    # Ten minutes hardly show waves.
    assert eth["cox-gmm"].heldout == pytest.approx(eth["poisson-groups"].heldout, abs=0.01)


def test_a_model_without_hazards_has_no_gaps_to_test(eth: dict[str, Checked]) -> None:
    assert eth["ntpp-paper"].gaps is None
    assert eth["poisson-paper"].gaps is not None


def test_most_of_what_eths_models_gain_over_poisson_is_groups(eth: dict[str, Checked]) -> None:
    poisson, groups, ntpp = (
        eth[name].heldout for name in ("poisson-gmm", "poisson-groups", "ntpp-gmm")
    )
    assert (groups - poisson) / (ntpp - poisson) > 0.9


def test_the_command_prints_a_row_per_model(
    plaza: dict[str, Checked],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def known(scene: Scene) -> list[Checked]:
        assert scene.id == "plaza-v0"
        return list(plaza.values())

    monkeypatch.setattr(spawn_diagnostics, "check_models", known)
    assert main(["spawn", "test", "plaza-v0"]) == 0
    printed = capsys.readouterr().out
    for name in ("plaza-truth", *DEFAULT_FITS):
        assert name in printed
    assert "ntpp-gmm has a trained network in 4 of 4 areas" in " ".join(printed.split())
