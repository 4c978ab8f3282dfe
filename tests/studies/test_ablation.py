"""The study of windows and strides: complete, resumable, and its sentence says what numbers say."""

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
from crowdbench.spawn import ntpp_training
from crowdbench.spawn.ntpp_training import Settings
from crowdbench.studies.ablation import study, write_ablation
from crowdbench.studies.ablation.finding import finding
from crowdbench.studies.ablation.measures import Numbers
from crowdbench.studies.ablation.presence import Presence, stretches
from crowdbench.studies.ablation.study import Configuration, Sample, configurations

pytestmark = pytest.mark.long

TINY = Settings(epochs=3, patience=1, calibration_points=2000)
POISSON = Configuration("poisson-gmm")


class Study:
    """A small study of the plaza, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.work = folder / "results/ablation-plaza-v0"
        self.page = folder / "docs/ablation/plaza-v0.md"

    def by_command(self) -> None:
        """Make it as the pages of such studies say."""
        asked = pages.arguments("docs/ablation/gc-v0.md", "crowdbench ablation")
        with self.small():
            assert cli.main(["ablation", *asked, "--workers", "1"]) == 0

    def again(self) -> list[tuple[int, int]]:
        """Make what is missing, and the page; what was said of its progress."""
        told: list[tuple[int, int]] = []
        with self.small():
            written = write_ablation(
                "plaza-v0", workers=1, progress=lambda done, total: told.append((done, total))
            )
            assert written.resolve() == self.page
        return told

    @contextmanager
    def small(self) -> Iterator[None]:
        """In its folder, with fewer configurations, samples and epochs."""
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self.folder)
            patch.setattr(study, "WINDOWS_FRAMES", (100, 500))
            patch.setattr(study, "STRIDES_FRAMES", (50,))
            patch.setattr(study, "SAMPLES", 2)
            patch.setattr(ntpp_training, "SETTINGS", TINY)
            yield

    def samples(self) -> dict[str, Sample]:
        files = sorted(self.work.glob("*.json"))
        return {f.stem: msgspec.json.decode(f.read_bytes(), type=Sample) for f in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Study:
    found = Study(tmp_path_factory.mktemp("ablation"))
    found.by_command()
    return found


def rows(text: str) -> list[list[str]]:
    """The cells of the table of numbers, without its head."""
    text = text.split("## Numbers")[-1]
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_each_configuration_has_its_row_in_both_schemes(made: Study) -> None:
    text = made.page.read_text(encoding="utf-8")
    names = ["recording", "poisson-gmm", "renewal-gmm", "ntpp-gmm 100/50", "ntpp-gmm 500/50"]
    found = [(row[0], row[1]) for row in rows(text)]
    assert found == [(n, s) for s in ("1 × 4,500", "10 × 450") for n in names]
    assert text.count("the paper’s finding") == 2
    assert "crowdbench ablation plaza-v0" in text


def test_numbers_are_those_of_the_samples(made: Study) -> None:
    table = rows(made.page.read_text(encoding="utf-8"))
    samples = made.samples()
    for row in table:
        if row[0] == "recording":
            continue
        stem = row[0].replace(" ", "-").replace("/", "-")
        scheme = 0 if row[1].startswith("1 ") else 1
        each = [s.present[scheme] for name, s in samples.items() if name.startswith(stem)]
        mean = [p.mean for p in each]
        assert row[2] == f"{np.mean(mean):.1f} ± {np.std(mean, ddof=1):.1f}"
        assert row[3] == f"{np.mean([p.sd for p in each]):.2f} ± " + (
            f"{np.std([p.sd for p in each], ddof=1):.2f}"
        )


def test_every_scored_family_is_scored_in_rollouts_as_long_as_the_recording(made: Study) -> None:
    for row in rows(made.page.read_text(encoding="utf-8")):
        simulated = row[0] != "recording" and row[1].startswith("1 ")
        assert ("–" in row[6:12]) == (not simulated)
        assert bool(re.fullmatch(r"−?\d\.\d\d \[.*\]", row[11])) == simulated


def test_the_recordings_own_row_is_what_the_reference_says(made: Study) -> None:
    scene = load_scene("plaza-v0")
    reference = read_reference(scene)
    whole, tenths = study.recorded_presence(recording_of(scene))
    for name, value in (("agents_over_time", whole.mean), ("agents_sd", whole.sd)):
        metric = next(m for m in METRICS if m.name == name)
        statistics = reference.statistics[name]
        recorded = metric.compare(statistics, statistics, reference.blocks).recorded
        assert recorded == pytest.approx(value)
    assert whole.counts == tenths.counts  # cut otherwise, but of the same frames
    assert whole.pairs[0] - tenths.pairs[0] == 9 * 150  # pairs that straddle a cut, 60 s


def test_the_distance_is_the_one_that_is_scored(made: Study) -> None:
    reference = read_reference(load_scene("plaza-v0"))
    metric = next(m for m in METRICS if m.name == "agents_over_time")
    recorded, _ = study.recorded_presence(recording_of(load_scene("plaza-v0")))
    for sample in made.samples().values():
        of_metric = metric.compare(
            reference.statistics[metric.name], sample.of(metric.name), reference.blocks
        )
        assert sample.present[0].distance(recorded) == pytest.approx(of_metric.distance)


def test_the_picture_is_there_and_small(made: Study) -> None:
    link = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", made.page.read_text(encoding="utf-8"))
    assert link == ["plaza-v0/agents.png"]
    data = (made.page.parent / link[0]).read_bytes()
    assert data.startswith(b"\x89PNG")
    assert len(data) < 200_000


def test_what_is_there_is_kept_and_what_is_missing_is_made(made: Study) -> None:
    before, text = made.samples(), made.page.read_bytes()
    assert made.again() == [(8, 8)]
    assert made.page.read_bytes() == text
    (made.work / "ntpp-gmm-100-50_1.json").unlink()
    (made.work / "poisson-gmm_0.json").write_text("{half")
    stale = made.work / "ntpp-gmm-500-50_0.json"
    stale.write_bytes(stale.read_bytes().replace(b'"made_from":"', b'"made_from":"0'))
    halves = [made.work / ".poisson-gmm_0-x1.json", made.page.parent / ".plaza-v0-x1.md"]
    for half in halves:  # as a call that is killed leaves behind
        half.touch()
    assert made.again() == [(k, 8) for k in (5, 6, 7, 8)]
    assert not any(half.exists() for half in halves)
    after = made.samples()
    # All but how long it took.
    plain = {n: msgspec.structs.replace(s, training_s=0.0) for n, s in before.items()}
    assert {n: msgspec.structs.replace(s, training_s=0.0) for n, s in after.items()} == plain


def test_other_settings_of_training_make_the_neural_models_samples_stale(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = study.plan(load_scene("plaza-v0"), Path("work"))
    changed = replace(ntpp_training.SETTINGS, learning_rate=1e-3)
    monkeypatch.setattr(ntpp_training, "SETTINGS", changed)
    after = study.plan(load_scene("plaza-v0"), Path("work"))
    for old, new in zip(before, after, strict=True):
        neural = new.configuration.spawn == "ntpp-gmm"
        assert (old.fingerprint != new.fingerprint) == neural


def test_another_recording_makes_all_samples_stale(home: Path) -> None:
    before = study.plan(load_scene("eth-v0"), Path("work"))
    cached("eth").parent.mkdir(parents=True, exist_ok=True)
    cached("eth").write_bytes(b"another")
    after = study.plan(load_scene("eth-v0"), Path("work"))
    assert all(old.fingerprint != new.fingerprint for old, new in zip(before, after, strict=True))


def test_samples_of_a_configuration_differ(made: Study) -> None:
    samples = made.samples()
    assert samples["ntpp-gmm-100-50_0"].nats != samples["ntpp-gmm-100-50_1"].nats
    assert samples["poisson-gmm_0"].present != samples["poisson-gmm_1"].present
    assert samples["ntpp-gmm-100-50_0"].nats != samples["ntpp-gmm-500-50_0"].nats


def test_without_the_recording_nothing_is_begun(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="crowdbench data import eth"):
        write_ablation("eth-v0", out=tmp_path / "docs", work=tmp_path / "work")
    assert list(tmp_path.iterdir()) == []


def test_no_workers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="workers"):
        write_ablation("plaza-v0", out=tmp_path, workers=0)


def test_the_study_is_the_papers() -> None:
    labels = [c.label.removeprefix("ntpp-gmm ") for c in configurations()]
    assert labels[:2] == ["poisson-gmm", "renewal-gmm"]
    assert labels[2:] == ["100/5", "100/50", "500/5", "500/50", "1000/5", "1000/50"]


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


def numbers(
    of: dict[Configuration, tuple[float, float]], spread: float = 0.1
) -> dict[Configuration, Numbers]:
    """Five samples around a standard deviation and a distance of each."""
    noise = spread * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    return {
        c: Numbers([5.0] * 5, (sd + noise).tolist(), [0.5] * 5, (far + noise / 10).tolist())
        for c, (sd, far) in of.items()
    }


def ntpp(window: int, stride: int) -> Configuration:
    return Configuration("ntpp-gmm", window, stride)


HOLDS = {
    POISSON: (2.0, 0.5),
    ntpp(100, 5): (2.05, 0.5),
    ntpp(100, 50): (2.0, 0.505),
    ntpp(500, 5): (3.0, 0.2),
    ntpp(500, 50): (3.0, 0.2),
}


def test_a_finding_that_holds_is_said_to_hold() -> None:
    verdict, why = finding(numbers(HOLDS))
    assert verdict.startswith("holds. ")
    assert "degenerate to Poisson: yes. All longer windows are better: yes." in verdict
    assert why.count("no significant difference") == 4
    assert (
        "| ntpp-gmm 500/5 | ntpp-gmm 100/5 | distance | 0.200 ± 0.0079 | 0.500 ± 0.0079 | "
        "significantly lower |"
    ) in why


def test_short_windows_that_vary_more_than_poisson_do_not_degenerate() -> None:
    verdict, why = finding(numbers(HOLDS | {ntpp(100, 50): (2.8, 0.5)}))
    assert verdict.startswith("holds in part. ")
    assert "degenerate to Poisson: no. All longer windows are better: yes." in verdict
    assert re.findall(r"ntpp-gmm 100/(\d+) \| poisson-gmm \| (.*?) \|.*higher", why) == [
        ("50", "sd of N")
    ]


def test_longer_windows_that_are_no_nearer_are_not_better() -> None:
    verdict, why = finding(numbers(HOLDS | {ntpp(500, 5): (3.0, 0.5)}))
    assert verdict.startswith("holds in part. ")
    assert "degenerate to Poisson: yes. All longer windows are better: no." in verdict
    assert re.findall(r"ntpp-gmm 500/(\d+) .*lower", why) == ["50"]


def test_longer_windows_that_are_farther_are_worse() -> None:
    away = {c: (2.8, 0.2) if c.window_frames == 100 else (3.0, 0.5) for c in HOLDS if c != POISSON}
    verdict, why = finding(numbers(HOLDS | away))
    assert verdict.startswith("does not hold")
    assert len(re.findall(r"ntpp-gmm 500/.*significantly higher", why)) == 2


def test_a_difference_within_the_spread_over_samples_says_nothing() -> None:
    verdict, _ = finding(numbers(HOLDS, spread=10.0))
    assert verdict.startswith("holds in part. ")
