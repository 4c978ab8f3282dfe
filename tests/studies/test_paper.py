"""The page on the founding paper: complete, resumable, and its verdicts follow from its numbers."""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import msgspec
import numpy as np
import pages
import pytest
from scipy.stats import ttest_ind, wasserstein_distance

from crowdbench.data.recordings.catalogue import cached
from crowdbench.errors import OutputError, RecordingError, SettingError, WeightsError
from crowdbench.metrics import METRICS, MetricResult
from crowdbench.registry import recording_of
from crowdbench.run.judge import draws_of
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn import (
    SpawnEvents,
    arrivals_of,
)
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.ntpp import training as ntpp_training
from crowdbench.spawn.paper import training as ntpp_paper_training
from crowdbench.spawn.times.groups import KolmogorovSmirnov
from studies.__main__ import main as studies_main
from studies.paper import fits, kept_people, study, write_paper
from studies.paper.bursts import Bursts, interval_of, mode, share
from studies.paper.claims import claims
from studies.paper.evidence import Evidence, noise
from studies.paper.fits import (
    CODE,
    COMPARED,
    LITERAL,
    POISSON,
    POISSON_CODE,
    RECORDED,
    SHIPPED,
    Configuration,
    windowed,
)
from studies.paper.measures import _welch, difference, signs
from studies.paper.page import Verdicts, overview
from studies.paper.presence import Presence, stretches
from studies.paper.study import Sample
from studies.paper.tables import own_density

PLAZA = load_scene("plaza-v0")
PLAZA_ARRIVALS = arrivals_of(
    recording_of(PLAZA),
    read_reference(PLAZA).blocks.training("full"),
    len(read_areas(PLAZA).spawn),
)
ALL = [*dict.fromkeys([RECORDED, *COMPARED, *windowed()])]
SAMPLES = 2


class Study:
    """A small study of the plaza, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.work = folder / "results/paper-plaza-v0"
        self.overview = folder / "docs/paper.md"
        self.page = folder / "docs/paper/plaza-v0.md"

    def by_command(self) -> None:
        with self.small():
            assert studies_main(["paper", "plaza-v0", "--workers", "1"]) == 0

    def again(self) -> list[tuple[int, int]]:
        """Make what is missing, and the page; what was said of its progress."""
        told: list[tuple[int, int]] = []
        with self.small():
            written = write_paper(
                "plaza-v0", workers=1, progress=lambda done, total: told.append((done, total))
            )
            assert written.resolve() == self.page
        return told

    @contextmanager
    def small(self) -> Iterator[None]:
        """In its folder, with fewer samples, windows, strides and epochs."""
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self.folder)
            # Other tests may have imported the plaza, of which samples know the file.
            patch.setenv("CROWDBENCH_HOME", str(self.folder / "home"))
            patch.setattr(study, "SAMPLES", SAMPLES)
            patch.setattr(study, "DRAWS", 2)
            # The package has a function of the name of its module `claims`.
            for module in (fits, import_module("studies.paper.claims")):
                patch.setattr(module, "WINDOWS_FRAMES", (100, 1000))
                patch.setattr(module, "STRIDES_FRAMES", (50,))
            brief = ntpp_training.NtppSettings(epochs=3, patience=1, calibration_points=2000)
            patch.setattr(ntpp_training, "DEFAULT", brief)
            patch.setattr(
                ntpp_paper_training, "DEFAULT", ntpp_paper_training.PaperSettings(epochs=2)
            )
            yield

    def windowed(self) -> list[Configuration]:
        with self.small():
            return windowed()

    def samples(self) -> dict[str, Sample]:
        files = sorted(self.work.glob("*.json"))
        return {f.stem: msgspec.json.decode(f.read_bytes(), type=Sample) for f in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Study:
    found = Study(tmp_path_factory.mktemp("paper"))
    found.by_command()
    return found


def tables(text: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its head."""
    lines = text.split(f"{heading}\n")[1].split("\n\n")
    block = next(b.strip() for b in lines if b.lstrip().startswith("| "))
    return [[c.strip() for c in line.strip("|").split("|")] for line in block.splitlines()[2:]]


@pytest.mark.nightly
class TestPage:
    def test_every_claim_has_a_verdict_and_its_reasons(self, made: Study) -> None:
        text = made.page.read_text(encoding="utf-8")
        assert pages.commands(text)[0] == "python -m studies paper plaza-v0"
        overview = made.overview.read_text(encoding="utf-8")
        assert "| claim | [plaza-v0](paper/plaza-v0.md) |" in overview
        verdicts = tables(overview, "## Which claims hold")
        assert len(verdicts) == 6
        for claim, verdict in verdicts:
            if "Grand Central" in claim:  # this is the plaza
                assert verdict == "–"
                assert f"## {claim}" not in text
            else:
                start = "" if verdict == "–" else f"{verdict.capitalize()}. "
                (why,) = re.findall(rf"^## {re.escape(claim)}\n\n(.*?)\n\n", text, re.M | re.S)
                assert " ".join(why.split()).startswith(start.strip())

    def test_each_model_has_its_row_in_both_schemes(self, made: Study) -> None:
        rows = tables(made.page.read_text(encoding="utf-8"), "## Windows and strides")
        first = (POISSON, POISSON_CODE, SHIPPED)
        names = ["recorded", *(c.label for c in (*first, *made.windowed()))]
        assert [(r[0], r[1]) for r in rows] == [
            (n, s) for s in ("1 × 4,500", "10 × 450") for n in names
        ]

    def test_numbers_are_those_of_the_samples(self, made: Study) -> None:
        rows = tables(made.page.read_text(encoding="utf-8"), "## Windows and strides")
        samples = made.samples()
        for configuration in dict.fromkeys([*COMPARED, *made.windowed()]):
            for k in (0, 1):
                each = [samples[f"{configuration.stem}_{seed}"].present[k] for seed in (0, 1)]
                row = next(r for r in rows[k * len(rows) // 2 :] if r[0] == configuration.label)
                mean, deviation = row[2].split(" ± ")
                values = [p.mean for p in each]
                assert float(mean) == pytest.approx(np.mean(values), rel=6e-3)
                assert float(deviation) == pytest.approx(np.std(values, ddof=1), rel=0.06)

    def test_the_pictures_are_there_and_small(self, made: Study) -> None:
        text = made.page.read_text(encoding="utf-8")
        assert "in 2 rollouts of each model" in " ".join(text.split())  # as many as were made
        links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
        assert len(links) == len(set(links)) == 8
        for link in links:
            data = (made.page.parent / link).read_bytes()
            assert data.startswith(b"\x89PNG")
            assert len(data) < 300_000

    def test_what_is_there_is_kept_and_what_is_missing_is_made(self, made: Study) -> None:
        before, text = made.samples(), made.page.read_bytes()
        windows = made.windowed()
        fits = sum(SAMPLES if c.spawn == "ntpp-gmm" else 1 for c in windows)
        samples = SAMPLES * len({RECORDED, *COMPARED, *windows})
        told = made.again()
        assert told == [(fits, fits), (samples, samples)]
        assert made.page.read_bytes() == text
        (made.work / "ntpp-gmm-100-50_1.json").unlink()
        (made.work / "poisson-gmm_0.json").write_text("{half")
        (made.work / "replay_0_straight.parquet").unlink()
        stale = made.work / "ntpp-gmm-1000-50_0.json"
        stale.write_bytes(stale.read_bytes().replace(b'"made_from":"', b'"made_from":"0'))
        (made.work / "fits/ntpp-paper-100-50_0.safetensors").write_bytes(b"half")
        halves = [
            made.work / ".poisson-gmm_0-0123abcd.json",
            made.page.parent / ".plaza-v0-0123abcd.md",
        ]
        for half in halves:  # as a call that is killed leaves behind
            half.touch()
            os.utime(half, (0, 0))
        told = made.again()
        assert told == [
            *((k, fits) for k in (fits - 1, fits)),
            *((k, samples) for k in range(samples - 4, samples + 1)),
        ]
        assert not any(half.exists() for half in halves)
        assert made.samples() == before

    def test_the_recordings_own_row_is_what_the_reference_says(self) -> None:
        reference = read_reference(PLAZA)
        whole, tenths = study.recorded_presence(recording_of(PLAZA))
        for name, value in (("agents_over_time", whole.mean), ("agents_sd", whole.sd)):
            metric = next(m for m in METRICS if m.name == name)
            statistics = reference.statistics[name]
            recorded = metric.compare(statistics, statistics, reference.blocks).recorded
            assert recorded == pytest.approx(value)
        assert whole.counts == tenths.counts  # cut otherwise, but of the same frames
        assert whole.pairs[0] - tenths.pairs[0] == 9 * 150  # pairs that straddle a cut, 60 s

    def test_samples_of_a_model_differ(self, made: Study) -> None:
        samples = made.samples()
        assert samples["ntpp-gmm-100-50_0"].nats != samples["ntpp-gmm-100-50_1"].nats
        assert samples["ntpp-paper-100-50_0"].nats == samples["ntpp-paper-100-50_1"].nats  # one fit
        for stem in ("ntpp-paper-100-50", "poisson-gmm"):
            assert samples[f"{stem}_0"].present != samples[f"{stem}_1"].present
            assert samples[f"{stem}_0"].bursts != samples[f"{stem}_1"].bursts


def test_other_settings_of_training_make_fits_and_samples_stale(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = study.plan(PLAZA, PLAZA_ARRIVALS, Path("work"))
    changed = replace(ntpp_training.DEFAULT, patience=7)
    monkeypatch.setattr(ntpp_training, "DEFAULT", changed)
    after = study.plan(PLAZA, PLAZA_ARRIVALS, Path("work"))
    for old, new in zip(before, after, strict=True):
        neural = new.fit is not None and new.configuration.spawn == "ntpp-gmm"
        assert (old.made_from != new.made_from) == neural


def test_other_arrivals_make_fits_stale_and_another_recording_all_samples(home: Path) -> None:
    before = study.plan(PLAZA, PLAZA_ARRIVALS, Path("work"))
    other = replace(PLAZA_ARRIVALS, tick=PLAZA_ARRIVALS.tick + 1)
    after = study.plan(PLAZA, other, Path("work"))
    for old, new in zip(before, after, strict=True):
        assert (old.made_from != new.made_from) == (new.fit is not None)
    cached("plaza").parent.mkdir(parents=True, exist_ok=True)
    cached("plaza").write_bytes(b"another")
    after = study.plan(PLAZA, PLAZA_ARRIVALS, Path("work"))
    assert all(old.made_from != new.made_from for old, new in zip(before, after, strict=True))


def test_the_papers_model_has_one_fit_and_crowdbenchs_one_for_each_sample() -> None:
    jobs = study.plan(PLAZA, PLAZA_ARRIVALS, Path("work"))
    for job in jobs:
        if job.fit is not None:
            paper = job.configuration.spawn == "ntpp-paper"
            assert job.fit.seed == (0 if paper else job.seed)
            rate = job.fit.settings.learning_rate
            assert rate == (5e-3 if job.configuration.code or not paper else 1e-4)
            assert job.fit.settings.window_frames == job.configuration.window_frames
            assert job.fit.settings.epochs == 500
    labels = [c.label.removeprefix("ntpp-paper ") for c in windowed()[:6]]
    assert labels == ["100/5", "100/50", "500/5", "500/50", "1000/5", "1000/50"]


def test_without_the_recording_nothing_is_begun(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="crowdbench data import eth"):
        write_paper("eth-v0", out=tmp_path / "docs", work=tmp_path / "work")
    assert list(tmp_path.iterdir()) == []


def test_the_papers_number_of_people_stands_beside_ours() -> None:
    crowd = recording_of(PLAZA)
    kept = kept_people(crowd, "eth")
    assert kept["recorded"] == f"{len(crowd)} people"
    assert kept["paper"] == "258 people on ETH"
    assert "difference" in kept_people(crowd, "gc")
    assert "paper" not in kept_people(crowd, "plaza")


def test_no_workers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="workers"):
        write_paper("plaza-v0", out=tmp_path, workers=0)


def test_poisson_arrivals_have_no_bursts_and_areas_that_do_not_depend_on_each_other() -> None:
    rng = np.random.default_rng(0)
    time_s = np.sort(rng.uniform(0, 60_000.0, 30_000))
    area = rng.integers(0, 3, 30_000)
    stretches_s = np.array([[0.0, 60_000.0]])
    found = Bursts.of(time_s, area, stretches_s, PLAZA, 3)
    assert (found.persons, found.interval_s, found.intervals) == (30_000, 60.0, 1000)
    assert found.fano == pytest.approx(1.0, abs=0.15)
    assert found.correlation == pytest.approx(0.0, abs=0.07)
    ten = 10 * PLAZA.dt_s
    assert sum(found.people) == sum(found.occupied) == int(60_000 / ten)
    assert np.dot(found.people, range(len(found.people))) == 30_000
    assert len(found.occupied) <= 11


def test_groups_and_common_waves_are_seen() -> None:
    rng = np.random.default_rng(1)
    alone = np.sort(rng.uniform(0, 30_000.0, 5_000))
    stretches_s = np.array([[0.0, 30_000.0]])
    together = Bursts.of(np.repeat(alone, 3), np.tile([0, 1, 1], len(alone)), stretches_s, PLAZA, 2)
    # Three at a time: variance 9 times, mean 3 times; both areas at the same times.
    assert together.fano == pytest.approx(3.0, abs=0.5)
    assert together.correlation == pytest.approx(1.0, abs=0.01)
    assert together.people[1] == together.people[2] == 0
    assert together.people[0] == together.occupied[0]


def test_only_whole_intervals_of_observed_time_count() -> None:
    stretches_s = np.array([[0.0, 12.5], [20.0, 27.9]])
    time_s = np.array([0.0, 3.9, 4.0, 12.1, 15.0, 20.1])
    found = Bursts.of(time_s, np.zeros(6, dtype=np.int64), stretches_s, PLAZA, 1)
    assert found.persons == 5  # all but that at 15 s
    counts = np.array([2, 1, 0, 1])  # of three whole intervals of 4 s, and of one
    assert (found.interval_s, found.intervals) == (10 * PLAZA.dt_s, 4)
    assert found.fano == pytest.approx(counts.var(ddof=1) / counts.mean())
    assert found.correlation == 0.0


def test_intervals_are_as_long_as_the_recording_allows() -> None:
    for length_s, expected in ((1_800.0, 60.0), (1_799.0, 20.0), (600.0, 20.0), (599.0, 4.0)):
        assert interval_of(np.array([[0.0, length_s]]), PLAZA) == pytest.approx(expected)
    assert interval_of(np.array([[0.0, 59.0]] * 40), PLAZA) == 20.0  # no minute fits into any


def test_people_of_a_model_enter_at_annotated_times() -> None:
    class AtOddTimes:
        name, start = "odd", "stationary"

        def sample(self, horizon_s: float, scene: Scene, rng: np.random.Generator) -> SpawnEvents:
            times = np.arange(0.1, horizon_s, 4.0)
            return read_areas(scene).draw(times, np.zeros(len(times), np.int64), scene, rng)

    assert PLAZA.horizon_s == 1800.0
    for grid_s, persons in ((2.0, 450), (4.0, 449)):  # at 2, 6, 10 … s, and at 4, 8, … 1796 s
        coarse = replace(
            PLAZA_ARRIVALS, grid_s=grid_s, windows=np.array([[0, round(1800 / grid_s)]])
        )
        found = study._bursts(PLAZA, AtOddTimes(), 0, coarse)
        assert found.persons == persons
        assert found.people == [450 - persons, persons]


def test_share_and_mode_of_a_histogram() -> None:
    counts = [1, 0, 4, 2, 3]
    assert share(counts, (4, 5)) == 0.3
    assert mode(counts) == 2


def test_parts_cover_what_is_observed_once() -> None:
    observed = np.array([[3, 20], [22, 41], [60, 95]])
    for parts, frames in ((1, 95), (10, 95), (7, 97)):
        length = -(-frames // parts)
        found = stretches(observed, frames, parts)
        seen = [-(-frames * part // parts) + t for part, a, b in found for t in range(a, b)]
        assert seen == [t for a, b in observed.tolist() for t in range(a, b)]
        assert max(stop for _, _, stop in found) <= length


def test_presence_is_that_of_the_series() -> None:
    rng = np.random.default_rng(0)
    walk = np.abs(rng.integers(-1, 2, size=900).cumsum())
    other = np.abs(rng.integers(-1, 2, size=700).cumsum())
    found = Presence.of([walk[:500], walk[500:]], 0.4)
    assert (found.mean, found.sd) == (pytest.approx(walk.mean()), pytest.approx(walk.std()))
    x = np.r_[walk[:350], walk[500:750]]
    y = np.r_[walk[150:500], walk[650:]]
    assert found.correlation == pytest.approx(np.corrcoef(x, y)[0, 1])
    expected = wasserstein_distance(other, walk) / walk.mean()
    assert Presence.of([other], 0.4).distance(found) == pytest.approx(expected)
    assert Presence.of([walk[:150]], 0.4).correlation is None


def test_differences_within_the_spread_over_samples_say_nothing() -> None:
    near, far = [1.0, 1.1, 0.9, 1.05, 0.95], [2.0, 2.1, 1.9, 2.05, 1.95]
    assert signs([(near, far), (far, near), (near, near[::-1])]) == [-1, 1, 0]
    assert signs([([1.0], [2.0])]) == [0]
    assert signs([([1.0, 1.0], [2.0, 2.0])]) == [-1]
    tiny = [0.1 + 0.2, 0.3, 0.3]  # which differ by rounding
    assert signs([(tiny, tiny[::-1]), (tiny, [0.4, 0.4, 0.4])]) == [0, -1]
    assert difference(tiny, [0.4, 0.4, 0.4]) == pytest.approx((-0.1, -0.1))


SERIES = [5, 6, 7, 6, 5, 4] * 200


def bursts(fano: float = 1.0, correlation: float = 0.0, people: int = 3) -> Bursts:
    counts = [0] * people + [10]
    return Bursts(
        persons=100, interval_s=60.0, intervals=40, fano=fano, correlation=correlation,
        people=counts, occupied=counts,
    )  # fmt: skip


def sample(
    k: int,
    scale: float = 0.5,
    fano: float = 1.0,
    correlation: float = 0.0,
    p: float = 0.5,
    people: int = 3,
) -> Sample:
    """A sample whose N(t) varies `scale` times as much as recorded."""
    noise = 0.01 * k
    series = np.round(100 + 100 * (scale + noise) * (np.array(SERIES) - 5.5)).astype(np.int64)
    return Sample(
        schema=2, made_from="", nats=-1.0, training_s=1.0,
        own=KolmogorovSmirnov(0.1, p, 100),
        present=[Presence.of([series.clip(0)], 0.4)] * 2,
        bursts=[bursts(fano + noise, correlation + noise, people)] * 3,
    )  # fmt: skip


def evidence(scene: Scene = PLAZA, **of: dict) -> Evidence:
    """Evidence in which all models are like Poisson, except as said by name of model."""
    names = {"literal": LITERAL, "code": CODE, "shipped": SHIPPED, "own_poisson": POISSON_CODE}
    said = {names[name].model: dict(values) for name, values in of.items() if name in names}
    far = {model: values.pop("far", 0.5) for model, values in said.items()}
    samples: dict[Configuration, list[Sample]] = {}
    for one in ALL:
        values = dict(said.get(one.model, {}))
        scales = values.pop("scales", {})
        values["scale"] = scales.get(one.window_frames, values.get("scale", 0.5))
        samples[one] = [sample(k, **values) for k in range(5)]
    distances = {(one, "bc-paper"): far.get(one.model, 0.5) for one in COMPARED}
    distances[RECORDED, "bc-paper"] = of.get("cloned", 0.5)
    distances[RECORDED, "straight"] = 0.8
    walked = {
        key: [
            {
                name: MetricResult(far + 0.01 * k, 10.0, 10.0, "", 100)
                for name in ("inter_spawn", "agents_over_time", "dwell")
            }
            for k in range(5)
        ]
        for key, far in distances.items()
    }
    wide = np.round(100 + 100 * (np.array(SERIES) - 5.5)).astype(np.int64).clip(0)
    return Evidence(
        scene=scene,
        walker="bc-paper",
        bursts=of.get("seen", bursts(fano=3.0, correlation=0.5)),
        present=[Presence.of([wide], 0.4)] * 2,
        samples=samples,
        walked=walked,
        dwell_noise=0.3,
    )


def verdicts(of: Evidence) -> list[str]:
    return [claim.verdict for claim in claims(of)]


def test_bursts_that_poisson_lacks() -> None:
    assert verdicts(evidence())[0] == "holds"
    assert verdicts(evidence(seen=bursts(fano=1.0)))[0] == "does not hold"
    claim = claims(evidence(code={"fano": 2.98}))[0]
    assert "within the samples’ range for its published code." in claim.why
    few = msgspec.structs.replace(bursts(fano=3.0, correlation=0.5), intervals=29)
    assert [verdicts(evidence(seen=few))[k] for k in (0, 3)] == ["–", "–"]


def test_models_that_are_closer_are_said_to_be_closer() -> None:
    all_closer = {name: {"far": 0.2} for name in ("literal", "code", "shipped")}
    assert verdicts(evidence(**all_closer))[1] == "holds"
    some = verdicts(evidence(literal={"far": 0.9}, code={"far": 0.2}))[1]
    assert some == (
        "the paper’s model: does not hold; its published code: holds; "
        "crowdbench’s ntpp-gmm: does not hold"
    )


def test_the_published_code_is_compared_with_its_own_poisson_process() -> None:
    claim = claims(evidence(own_poisson={"far": 0.2}))[1]
    assert claim.verdict == "does not hold"
    rows = [line for line in claim.why.splitlines() if "its published code |" in line]
    assert len(rows) == 2
    assert all("poisson-paper: 0.220 ±" in row and row.endswith("| higher |") for row in rows)


def test_the_spike_is_one_of_grand_central() -> None:
    assert verdicts(evidence())[2] == "–"
    gc = load_scene("gc-v0")
    assert verdicts(evidence(gc))[2] == "does not hold"
    assert verdicts(evidence(gc, seen=bursts(people=4)))[2] == "holds"
    both = msgspec.structs.replace(bursts(people=6), occupied=[0, 0, 0, 0, 10])
    claim = claims(evidence(gc, seen=both, literal={"people": 5}))[2]
    assert claim.verdict == "for frames, not for people"
    assert "Then ntpp-paper most often have 4 or 5 such frames too" in claim.why


def test_areas_that_depend_on_each_other() -> None:
    assert verdicts(evidence())[3] == "holds"
    alone = bursts(fano=3.0, correlation=0.02)
    assert verdicts(evidence(seen=alone))[3] == "undecided"
    assert verdicts(evidence(seen=alone, literal={"correlation": 0.5}))[3] == "does not hold"


def test_dwell_times_are_compared_with_the_recordings_own_noise() -> None:
    assert verdicts(evidence(cloned=0.1))[4] == "holds"
    assert verdicts(evidence(cloned=0.5))[4] == "no, but closer than straight walkers"
    assert verdicts(evidence(cloned=0.8))[4] == "does not hold"
    assert verdicts(evidence(cloned=0.9))[4] == "does not hold"


def test_windows_that_degenerate() -> None:
    # All windows are like Poisson, and so none is better.
    assert verdicts(evidence())[5] == "holds in part"
    grows = {"scales": {100: 0.5, 500: 0.95, 1000: 0.95}}
    of_all = dict.fromkeys(("literal", "code", "shipped"), grows)
    assert verdicts(evidence(**of_all))[5] == "holds"
    assert verdicts(evidence(literal={"scale": 0.9}))[5].startswith(
        "the paper’s model: does not hold"
    )
    # Windows that vary much less than Poisson are not like Poisson either.
    assert verdicts(evidence(literal={"scale": 0.1}))[5].startswith(
        "the paper’s model: does not hold"
    )
    close = {"scales": {100: 0.605, 500: 0.605, 1000: 0.605}}  # about a quarter of the gap
    assert verdicts(evidence(literal=close))[5].startswith("the paper’s model: undecided")


def test_where_poisson_varies_as_much_as_the_recording_there_is_no_gap() -> None:
    of = evidence()
    flat = replace(of, present=[Presence.of([np.full(900, 100)], 0.4)] * 2)
    assert verdicts(flat)[5] == "–"


def test_the_interval_of_a_difference_is_welchs() -> None:
    a, b = [3.0, 3.1, 2.9, 3.05, 2.95], [1.0, 1.2, 0.8, 1.1, 0.9]
    low, high = difference(a, b)
    assert low < 2.0 < high
    assert high - low == pytest.approx(2 * 2.457 * 0.0791, rel=0.01)  # t of 5.9 degrees
    assert difference([1.0, 1.0], [0.5, 0.5]) == (0.5, 0.5)
    known = ttest_ind(a, b, equal_var=False).confidence_interval(0.95)
    assert (low, high) == pytest.approx((known.low, known.high))
    assert _welch(a, b) == pytest.approx(ttest_ind(a, b, equal_var=False).pvalue)
    constant = _welch(a, [1.0, 1.0, 1.0])  # one of a deterministic policy: no warning
    assert 0 < constant < 1e-4


def test_the_noise_of_dwell_times_is_that_of_their_resamples() -> None:
    reference = read_reference(PLAZA)
    draws = draws_of(PLAZA, reference, "full")
    found = noise(reference, "dwell", draws)
    metric = next(m for m in METRICS if m.name == "dwell")
    whole = reference.statistics["dwell"]
    assert draws.blocks.shape[1] == len(reference.blocks)
    same = replace(draws, blocks=np.ones((3, len(reference.blocks)), dtype=np.int64))
    assert noise(reference, "dwell", same) == 0.0
    alone = np.zeros((1, len(reference.blocks)), dtype=np.int64)
    alone[0, 0] = 1
    first = {name: values[:1] for name, values in whole.items()}
    expected = metric.compare(whole, first, reference.blocks).distance
    assert noise(reference, "dwell", replace(draws, blocks=alone)) == pytest.approx(expected)
    assert 0 < found < expected


def test_samples_that_do_not_follow_their_density() -> None:
    text = own_density(evidence(code={"p": 1e-6}))
    assert [line.split(" | ")[-1] for line in text.splitlines()[2:]] == ["yes |", "no |"]
    assert "1e-06" in text


def test_the_overview_is_about_all_scenes_with_a_page() -> None:
    plaza = Verdicts(
        schema=1, scene="plaza-v0", title="Plaza", verdicts=[("A", "holds"), ("B", "–")]
    )
    other = Verdicts(
        schema=1, scene="x-v0", title="X", verdicts=[("A", "undecided"), ("C", "holds")]
    )
    lines = overview([plaza, other]).splitlines()
    assert "| claim | [plaza-v0](paper/plaza-v0.md) | [x-v0](paper/x-v0.md) |" in lines
    assert [line for line in lines if re.match(r"\| [ABC] ", line)] == [
        "| A | holds | undecided |",
        "| B | – | – |",
        "| C | – | holds |",
    ]


def test_verdicts_that_cannot_be_read_are_noticed_first(tmp_path: Path) -> None:
    file = tmp_path / "docs/paper/x-v0/verdicts.json"
    file.parent.mkdir(parents=True)
    file.write_text('{"schema": 1}')
    with pytest.raises(OutputError, match=r"x-v0[\s\S]*python -m studies paper"):
        write_paper("plaza-v0", out=tmp_path / "docs", work=tmp_path / "work")
    assert not (tmp_path / "work").exists()


def test_missing_fits_are_noticed_first(tmp_path: Path) -> None:
    place = tmp_path / "plaza-v0"
    shutil.copytree(PLAZA.folder, place)
    for file in place.glob("ntpp-gmm*"):
        file.unlink()
    with pytest.raises(WeightsError, match="ntpp-gmm"):
        write_paper(place, out=tmp_path / "docs", work=tmp_path / "work")
    assert not (tmp_path / "work").exists()
