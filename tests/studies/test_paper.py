"""The page on the founding paper: complete, resumable, and its verdicts follow from its numbers."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pages
import pytest
from scipy.stats import wasserstein_distance

from crowdbench import cli
from crowdbench.errors import RecordingError, SettingError
from crowdbench.metrics import METRICS
from crowdbench.recordings.catalogue import cached
from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn import arrivals_of, ntpp_paper_training, ntpp_training
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.rescaling import KolmogorovSmirnov
from crowdbench.studies.paper import study, write_paper
from crowdbench.studies.paper.bursts import Bursts, mode, share
from crowdbench.studies.paper.claims import Evidence, claims, own_density
from crowdbench.studies.paper.fits import (
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
from crowdbench.studies.paper.measures import signs
from crowdbench.studies.paper.presence import Presence, stretches
from crowdbench.studies.paper.study import Compared, Sample

PLAZA = load_scene("plaza-v0")
PLAZA_ARRIVALS = arrivals_of(
    recording_of(PLAZA),
    read_reference(PLAZA).blocks.training("full"),
    len(read_areas(PLAZA).spawn),
)
ALL = [*dict.fromkeys([RECORDED, *COMPARED, *windowed()])]


class Study:
    """A small study of the plaza, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.work = folder / "results/paper-plaza-v0"
        self.page = folder / "docs/paper.md"

    def by_command(self) -> None:
        with self.small():
            assert cli.main(["paper", "plaza-v0", "--workers", "1"]) == 0

    def again(self) -> list[tuple[int, int]]:
        """Make what is missing, and the page; what was said of its progress."""
        told: list[tuple[int, int]] = []
        with self.small():
            written = write_paper(
                ["plaza-v0"], workers=1, progress=lambda done, total: told.append((done, total))
            )
            assert written.resolve() == self.page
        return told

    @contextmanager
    def small(self) -> Iterator[None]:
        """In its folder, with fewer samples and epochs."""
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self.folder)
            patch.setattr(study, "SAMPLES", 2)
            patch.setattr(study, "DRAWS", 2)
            brief = ntpp_training.Settings(epochs=3, patience=1, calibration_points=2000)
            patch.setattr(ntpp_training, "SETTINGS", brief)
            patch.setattr(ntpp_paper_training, "PAPER", ntpp_paper_training.Settings(epochs=2))
            yield

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
    block = next(b for b in lines if b.startswith("| "))
    return [[c.strip() for c in line.strip("|").split("|")] for line in block.splitlines()[2:]]


@pytest.mark.long
class TestPage:
    def test_every_claim_has_a_verdict_and_its_reasons(self, made: Study) -> None:
        text = made.page.read_text(encoding="utf-8")
        assert pages.commands(text) == ["crowdbench paper plaza-v0"]
        verdicts = tables(text, "## Which claims hold")
        assert len(verdicts) == 6
        for claim, verdict in verdicts:
            start = "" if verdict == "–" else f"{verdict.capitalize()}. "
            assert f"### {claim}\n\n{start}" in text

    def test_each_model_has_its_row_in_both_schemes(self, made: Study) -> None:
        rows = tables(made.page.read_text(encoding="utf-8"), "### Windows and strides")
        first = (POISSON, POISSON_CODE, SHIPPED)
        names = ["recorded", *(c.label for c in (*first, *windowed()))]
        assert [(r[0], r[1]) for r in rows] == [
            (n, s) for s in ("1 × 4,500", "10 × 450") for n in names
        ]

    def test_numbers_are_those_of_the_samples(self, made: Study) -> None:
        rows = tables(made.page.read_text(encoding="utf-8"), "### Windows and strides")
        samples = made.samples()
        for configuration in ALL[1:]:
            for k in (0, 1):
                each = [samples[f"{configuration.stem}_{seed}"].present[k] for seed in (0, 1)]
                row = next(r for r in rows[k * len(rows) // 2 :] if r[0] == configuration.label)
                mean, deviation = row[2].split(" ± ")
                values = [p.mean for p in each]
                assert float(mean) == pytest.approx(np.mean(values), rel=6e-3)
                assert float(deviation) == pytest.approx(np.std(values, ddof=1), rel=0.06)

    def test_the_pictures_are_there_and_small(self, made: Study) -> None:
        links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", made.page.read_text(encoding="utf-8"))
        assert len(links) == 7
        for link in links:
            data = (made.page.parent / link).read_bytes()
            assert data.startswith(b"\x89PNG")
            assert len(data) < 300_000

    def test_what_is_there_is_kept_and_what_is_missing_is_made(self, made: Study) -> None:
        before, text = made.samples(), made.page.read_bytes()
        fits, samples = 42, 2 * len(ALL)
        told = made.again()
        assert told == [(fits, fits), (samples, samples)]
        assert made.page.read_bytes() == text
        (made.work / "ntpp-gmm-100-50_1.json").unlink()
        (made.work / "poisson-gmm_0.json").write_text("{half")
        (made.work / "replay_0_straight.parquet").unlink()
        stale = made.work / "ntpp-gmm-500-50_0.json"
        stale.write_bytes(stale.read_bytes().replace(b'"made_from":"', b'"made_from":"0'))
        (made.work / "fits/ntpp-paper-100-5_0.safetensors").write_bytes(b"half")
        halves = [made.work / ".poisson-gmm_0-x1.json", made.page.parent / ".paper-x1.md"]
        for half in halves:  # as a call that is killed leaves behind
            half.touch()
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
    changed = replace(ntpp_training.SETTINGS, patience=7)
    monkeypatch.setattr(ntpp_training, "SETTINGS", changed)
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
        write_paper(["eth-v0"], out=tmp_path / "docs", work=tmp_path / "work")
    assert list(tmp_path.iterdir()) == []


def test_no_workers_and_no_scenes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="workers"):
        write_paper(["plaza-v0"], out=tmp_path, workers=0)
    with pytest.raises(SettingError, match="no scene"):
        write_paper([], out=tmp_path)


def test_poisson_arrivals_have_no_bursts_and_areas_that_do_not_depend_on_each_other() -> None:
    rng = np.random.default_rng(0)
    time_s = np.sort(rng.uniform(0, 60_000.0, 30_000))
    area = rng.integers(0, 3, 30_000)
    stretches_s = np.array([[0.0, 60_000.0]])
    found = Bursts.of(time_s, area, stretches_s, PLAZA, 3)
    assert found.persons == 30_000
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
    stretches_s = np.array([[0.0, 125.0], [200.0, 259.0]])
    time_s = np.array([0.0, 59.9, 60.0, 121.0, 150.0, 210.0])
    found = Bursts.of(time_s, np.zeros(6, dtype=np.int64), stretches_s, PLAZA, 1)
    assert found.persons == 5  # all but that at 150 s
    counts = np.array([2, 1])  # of two whole minutes
    assert found.fano == pytest.approx(counts.var() / counts.mean())
    assert found.correlation == 0.0


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


SERIES = [5, 6, 7, 6, 5, 4] * 200


def bursts(fano: float = 1.0, correlation: float = 0.0, people: int = 3) -> Bursts:
    counts = [0] * people + [10]
    return Bursts(persons=100, fano=fano, correlation=correlation, people=counts, occupied=counts)


def sample(
    k: int,
    scale: float = 1.0,
    far: float = 0.5,
    fano: float = 1.0,
    correlation: float = 0.0,
    p: float = 0.5,
    policies: tuple[str, ...] = ("bc-paper",),
) -> Sample:
    """A sample whose N(t) varies `scale` times as much as recorded, `far` from the recording."""
    noise = 0.01 * k
    series = np.round(5.5 + (scale + noise) * (np.array(SERIES) - 5.5)).astype(np.int64)
    return Sample(
        schema=1, made_from="", nats=-1.0, training_s=1.0,
        own=KolmogorovSmirnov(0.1, p, 100),
        present=[Presence.of([series.clip(0)], 0.4)] * 2,
        bursts=[bursts(fano + noise, correlation + noise)] * 3,
        walked={
            policy: {
                name: Compared(distance=far + noise, value=10.0)
                for name in ("inter_spawn", "agents_over_time", "dwell")
            }
            for policy in policies
        },
    )  # fmt: skip


def evidence(**of: dict) -> Evidence:
    """Evidence in which all models are like Poisson, except as said by name of model."""
    names = {"literal": LITERAL, "code": CODE, "shipped": SHIPPED, "recorded": RECORDED}
    said = {names[name].model: values for name, values in of.items() if name in names}
    samples: dict[Configuration, list[Sample]] = {}
    for one in ALL:
        samples[one] = [sample(k, **said.get(one.model, {})) for k in range(5)]
    return Evidence(
        scene=PLAZA,
        walker="bc-paper",
        bursts=of.get("seen", bursts(fano=3.0, correlation=0.5)),
        present=[Presence.of([np.array(SERIES)], 0.4)] * 2,
        typical={"dwell": 10.0},
        samples=samples,
    )


def verdicts(of: Evidence) -> list[str]:
    return [claim.verdict for claim in claims(of)]


BOTH = {"policies": ("bc-paper", "straight")}


def test_bursts_that_poisson_lacks() -> None:
    assert verdicts(evidence(recorded=BOTH))[0] == "holds"
    assert verdicts(evidence(recorded=BOTH, seen=bursts(fano=1.0)))[0] == "does not hold"
    claim = claims(evidence(recorded=BOTH, code={"fano": 2.98}))[0]
    assert "within the samples’ range for its published code." in claim.why


def test_models_that_are_closer_are_said_to_be_closer() -> None:
    all_closer = {name: {"far": 0.2} for name in ("literal", "code", "shipped")}
    assert verdicts(evidence(recorded=BOTH, **all_closer))[1] == "holds"
    some = verdicts(evidence(recorded=BOTH, literal={"far": 0.9}, code={"far": 0.2}))[1]
    assert some == (
        "the paper’s model: does not hold; its published code: holds; "
        "crowdbench’s ntpp-gmm: does not hold"
    )


def test_areas_that_depend_on_each_other() -> None:
    assert verdicts(evidence(recorded=BOTH))[3] == "holds"
    alone = bursts(fano=3.0, correlation=0.01)
    assert verdicts(evidence(recorded=BOTH, seen=alone))[3] == "does not hold"


def test_windows_that_degenerate() -> None:
    # All windows are like Poisson, and so none is better.
    assert verdicts(evidence(recorded=BOTH))[5] == "holds in part"
    assert verdicts(evidence(recorded=BOTH, literal={"scale": 3.0}))[5].startswith(
        "the paper’s model: does not hold"
    )


def test_samples_that_do_not_follow_their_density() -> None:
    text = own_density(evidence(recorded=BOTH, code={"p": 1e-6}))
    assert [line.split(" | ")[-1] for line in text.splitlines()[2:]] == ["yes |", "no |"]
    assert "1e-06" in text
