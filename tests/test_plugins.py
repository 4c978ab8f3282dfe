"""Parts of other packages work wherever those of crowdbench do, without a change to it."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import crowdbench
from crowdbench import plugins
from crowdbench.cli import main
from crowdbench.errors import OwnCodeError, SettingError
from crowdbench.metrics import METRICS, all_metrics
from crowdbench.metrics.trips import Dwell
from crowdbench.plugins import register
from crowdbench.run.jobs import plan
from crowdbench.scene import load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import Observation, size_of
from crowdbench.simulation.social import SIZE

WIDE = {"COLUMNS": "200"}
PACKAGE = Path(__file__).parent / "extras_package"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the package of `extras_package` is installed."""
    site = tmp_path_factory.mktemp("site")
    wheel = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheel)]
    subprocess.run(build, cwd=PACKAGE, check=True, capture_output=True)
    (built,) = wheel.glob("*.whl")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, "--target", str(site), str(built)], check=True, capture_output=True)
    return site


def ran(installed: Path, cwd: Path, *command: str) -> str:
    path = os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, *command],
        cwd=cwd,
        env=os.environ
        | {"PYTHONPATH": path, "CROWDBENCH_HOME": str(cwd / "home"), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_an_installed_package_is_evaluated_with_its_metric_spawn_model_policy_and_observation(
    installed: Path, tmp_path: Path
) -> None:
    asked = ["evaluate", "plaza-v0", "--spawn", "clockwork", "--policy", "dawdler", "straight"]
    printed = ran(installed, tmp_path, "-m", "crowdbench", *asked, "--seeds", "1", "--workers", "2",
                  "--out", "out")  # fmt: skip
    assert "clockwork × dawdler" in printed
    assert "path length" in printed
    card = json.loads((tmp_path / "out" / "scorecard.json").read_text())
    of = {(e["spawn"], e["policy"]): e["metrics"] for e in card["entries"]}
    assert of["clockwork", "straight"]["path_length"]["recorded"] > 10
    dwell = [of["clockwork", policy]["dwell"]["simulated"] for policy in ("dawdler", "straight")]
    assert dwell[0] > 1.5 * dwell[1]
    assert "path_length" not in card["scored"]
    assert "path length" in (tmp_path / "out" / "report.html").read_text()


def test_what_is_installed_is_listed(installed: Path, tmp_path: Path) -> None:
    listed = ran(installed, tmp_path, "-m", "crowdbench", "scene", "metrics")
    assert "path_length" in listed
    assert "crowdbench_extras" in listed
    code = "import crowdbench as c; print(c.list_spawn_models('eth-v0'), c.list_policies('eth-v0'))"
    printed = ran(installed, tmp_path, "-c", code)
    assert "'ntpp-gmm'" in printed
    assert "'clockwork'" in printed
    assert "'gail'" in printed
    assert "'dawdler'" in printed
    assert "replay" not in printed  # the recording is not imported


def test_an_installed_format_is_imported_and_says_what_is_wrong_with_a_file(
    installed: Path, tmp_path: Path
) -> None:
    rows = [f"{p}\t{k}\t{0.5 * k}\t{p}" for p in (1, 2) for k in range(20)]
    (tmp_path / "mine.tsv").write_text("\n".join(rows))
    asked = ["data", "import", "mine", "--source", "mine.tsv", "--format", "columns"]
    assert "persons         2" in ran(
        installed, tmp_path, "-m", "crowdbench", *asked, "--dt-s", "0.4"
    )
    (tmp_path / "mine.tsv").write_text("no numbers")
    code = (
        "from crowdbench.cli import main\n"
        f"assert main({[*asked, '--dt-s', '0.4']!r}) == 2\n"
        f"assert main({[*asked[:-1], 'rows', '--dt-s', '0.4']!r}) == 2\n"
    )
    done = ran(installed, tmp_path, "-c", f"import sys\nsys.stderr = sys.stdout\n{code}")
    assert "format columns, mine.tsv: got ValueError" in done
    assert "got 'rows'; expected one of obsmat, gc, forum, csv, trajnet, jupedsim, " in done
    assert ", columns" in done


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is registered here is forgotten."""
    monkeypatch.setattr(plugins, "_registered", {kind: {} for kind in plugins.KINDS})


class Lonely(Observation):
    name, base, extra = "lonely-1", "lidar-1", 1

    def observe(self, simulation: Simulation, out: np.ndarray) -> None:
        out[..., 0] = np.minimum(simulation.nearest, 5.0) / 5.0


class Eastward:
    name, sees = "eastward", "observation"

    def reset(self, scene: object, rng: object) -> None: ...

    def act(self, seen: np.ndarray) -> np.ndarray:
        return np.tile(np.float32([0.3, 0.0]), (len(seen), 1))


@pytest.mark.long
@pytest.mark.usefixtures("free", "no_report")
def test_what_a_program_registers_is_known_to_it_and_to_its_workers(tmp_path: Path) -> None:
    register("policies", "eastward", Eastward)
    assert "eastward" in crowdbench.list_policies("plaza-v0")
    card = crowdbench.evaluate(
        "plaza-v0", spawn="poisson-gmm", policy="eastward", seeds=2, workers=2, out=tmp_path
    )
    (entry,) = (e for e in card.entries if (e.spawn, e.policy) == ("poisson-gmm", "eastward"))
    assert entry.outcomes["exit"] > 0.4 * entry.persons  # goals are everywhere


@pytest.mark.long
@pytest.mark.usefixtures("free", "no_report")
def test_a_metric_is_named_for_one_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (PACKAGE / "crowdbench_extras.py").read_text()
    (tmp_path / "of_mine.py").write_text(text.replace('"path_length"', '"length_of_mine"'))
    monkeypatch.chdir(tmp_path)
    asked = ["evaluate", "plaza-v0", "--spawn", "poisson-gmm", "--policy", "straight"]
    asked += ["--seeds", "2", "--workers", "2", "--out", "out", "--metric"]
    assert main([*asked, "of_mine:PathLength"]) == 0
    assert "length of mine" in capsys.readouterr().out
    (tmp_path / "broken.py").write_text(
        text.replace('"path_length"', '"broken"').replace("path_lengths()", "lengths()")
    )
    for name, message in (
        ("of_mine:Centre", "without family"),
        ("dwel", "got 'dwel'"),
        ("broken:PathLength", "metric broken: got AttributeError"),
    ):
        assert main([*asked, name]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.usefixtures("free")
def test_an_observation_has_the_frame_of_its_base() -> None:
    class LonelyAhead(Lonely):
        base = "social-1"

    register("observations", "lonely-1", LonelyAhead)
    envs = [crowdbench.parallel_env("plaza-v0", observation=name, horizon_s=60.0)
            for name in ("lonely-1", "social-1")]  # fmt: skip
    assert size_of("lonely-1", 32) == SIZE + 1
    seen, of_base = (env.reset(seed=1)[0] for env in envs)
    for _ in range(5):
        for agent, numbers in seen.items():
            assert numbers[:-1].tolist() == of_base[agent].tolist()
        seen, of_base = (env.step(dict.fromkeys(env.agents, np.float32([0.2, 0.1])))[0]
                         for env in envs)  # fmt: skip


@pytest.mark.usefixtures("free")
def test_an_observation_stands_behind_its_base() -> None:
    register("observations", "lonely-1", Lonely)
    env = crowdbench.parallel_env("plaza-v0", observation="lonely-1", horizon_s=60.0)
    plain = crowdbench.parallel_env("plaza-v0", observation="lidar-1", horizon_s=60.0)
    seen, of_base = env.reset(seed=1)[0], plain.reset(seed=1)[0]
    assert seen.keys() == of_base.keys()
    assert size_of("lonely-1", 32) == 5 + 32 + 1
    for agent, numbers in seen.items():
        assert numbers.shape == env.observation_space(agent).shape == (38,)
        assert numbers[:-1].tolist() == of_base[agent].tolist()
        assert 0 <= numbers[-1] <= 1


@pytest.mark.usefixtures("free")
def test_other_code_of_a_registered_part_makes_its_rollouts_stale(tmp_path: Path) -> None:
    def fingerprint() -> str:
        scene = load_scene("plaza-v0")
        (job,) = plan("plaza-v0", scene, [("poisson-gmm", "mine")], "full", 1, tmp_path)
        return job.fingerprint

    def made(factor: int) -> type:
        world = {"Base": Eastward, "__name__": "a_notebook"}  # there is no file of it
        exec(f"class Mine(Base):\n    factor = {factor}\n", world)
        kind: type = world["Mine"]  # type: ignore[assignment]
        return kind

    one, other = made(1), made(2)
    found = []
    for part in (one, one, other):
        register("policies", "mine", part)
        found.append(fingerprint())
    assert found[0] == found[1]
    assert found[0] != found[2]


@pytest.mark.usefixtures("free")
@pytest.mark.parametrize(
    ("kind", "name", "part", "message"),
    [
        ("metrics", "dwell", Dwell, "got dwell, registered by another package"),
        ("metrics", "mine", Eastward, "expected a subclass of crowdbench.metrics.Metric"),
        ("metrics", "mine", Dwell, "got the name 'dwell'"),
    ],
)
def test_what_is_no_metric_of_its_name_is_refused(
    kind: plugins.Kind, name: str, part: type, message: str
) -> None:
    register(kind, name, part)
    with pytest.raises(SettingError, match=message):
        all_metrics()


@pytest.mark.usefixtures("free")
def test_kinds_and_names_are_checked() -> None:
    with pytest.raises(SettingError, match=r"register.kind=….: got 'walls'"):
        register("walls", "mine", object())  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="got the name 'a:b'"):
        register("policies", "a:b", object())
    with pytest.raises(SettingError, match="one of lidar-1, lidar-2, lidar-3"):
        Settings(observation="lidar-9")
    register("observations", "mine", Eastward)
    with pytest.raises(SettingError, match=r"Derive it from crowdbench\.simulation"):
        Settings(observation="mine")


@pytest.mark.usefixtures("free")
def test_nobody_takes_a_name_of_ours_unnoticed() -> None:
    register("policies", "straight", Eastward)
    with pytest.raises(SettingError, match="got straight, registered by another package"):
        crowdbench.policy("straight", "plaza-v0")
    register("spawn_models", "ntpp-gmm", Eastward)
    with pytest.raises(SettingError, match="got ntpp-gmm, registered"):
        crowdbench.spawn_model("ntpp-gmm", "plaza-v0")


@pytest.mark.usefixtures("free")
def test_what_cannot_be_sent_to_workers_is_told() -> None:
    register("metrics", "mine", threading.Lock())
    with pytest.raises(OwnCodeError, match="on its way to worker processes: got TypeError"):
        plugins.shared()


def test_an_installed_metric_is_scored_where_the_recording_is(
    installed: Path, tmp_path: Path
) -> None:
    rows = [f"{p},{3 * p + k},{0.5 * k},5.0" for p in range(1490) for k in range(20)]
    (tmp_path / "mine.csv").write_text("\n".join(["person_id,frame,x,y", *rows]))
    printed = ran(installed, tmp_path, "-m", "crowdbench", "score", "plaza-v0", "mine.csv")
    assert "path length" in printed
    elsewhere = "from crowdbench.report.text.notes import missing_notes as n\n"
    elsewhere += "from crowdbench import load_scene as s; print(n(s('eth-v0')), n(s('plaza-v0')))"
    told = ran(installed, tmp_path, "-c", elsewhere)
    assert (
        "path_length can only be computed with the recording: `crowdbench data fetch eth`" in told
    )
    assert told.strip().endswith("[]")


def test_a_package_that_cannot_be_imported_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = SimpleNamespace(
        name="broken",
        value="broken:Metric",
        group="crowdbench.metrics",
        dist=SimpleNamespace(name="broken-package"),
        load=lambda: 1 / 0,
    )
    monkeypatch.setattr(plugins, "_installed", lambda kind: {"broken": entry})
    monkeypatch.setattr(plugins, "_load", plugins._load.__wrapped__)
    with pytest.raises(OwnCodeError, match="broken-package"):
        plugins.part("metrics", "broken")


def test_ours_are_all_there_without_others() -> None:
    assert all_metrics()[: len(METRICS)] == METRICS
