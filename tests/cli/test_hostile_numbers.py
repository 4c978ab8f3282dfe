"""Huge, negative and undefined numbers: one sentence at once, no traceback, no terabyte."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import crowdbench
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.scene import load_scene
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.steering.scenario import read_scenario

pytestmark = pytest.mark.long

HUGE = "1" + "0" * 40
COMMANDS = {
    "evaluate plaza-v0 --spawn poisson-gmm --policy straight --out out --seeds": (
        "-1",
        "1e9",
        HUGE,
    ),
    "evaluate plaza-v0 --spawn poisson-gmm --policy straight --out out --workers": ("-1", HUGE),
    "spawn sample plaza-v0 --model poisson-gmm --out a.csv --seed": ("-1", "nan", "1e30"),
    "spawn sample plaza-v0 --model poisson-gmm --out a.csv --horizon-s": ("-1", "nan", "1e9", HUGE),
    "exam --policy straight --test rimea-1 --body-radius-m": ("-1", "nan", "1e30"),
    "robots plaza-v0 --episodes": ("-1", HUGE),
    "robots plaza-v0 --episodes 1 --period-s": ("-1", "nan", "1e30"),
    "robots plaza-v0 --episodes 1 --time-limit-s": ("-1", "nan"),
    "scene fit plaza-v0 --out fitted --fits": ("-1", "1000000000", HUGE),
    "scene create mine-v0 --from nowhere.csv --fits": ("-1", "1000000000", HUGE),
    "leaderboard verify nothing --out verified --hours": ("-1", "nan", "1e30"),
    "leaderboard verify nothing --out verified --memory-gib": ("-1", "nan", "1e30"),
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory as Linux does")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_number_that_cannot_be_is_one_sentence(command: str, tmp_path: Path) -> None:
    for value in COMMANDS[command]:
        done = subprocess.run(
            [sys.executable, "-m", "crowdbench", *command.split(), value],
            cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
            preexec_fn=_little_memory, env=dict(os.environ),
        )  # fmt: skip
        assert "Traceback" not in done.stderr, done.stderr
        assert done.returncode == 2, (value, done.stderr, done.stdout)
    assert not list(tmp_path.iterdir())


def _little_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))


@pytest.mark.parametrize(
    ("added", "said"),
    [
        ("persons_per_min = 1e12", "persons_per_min: got 1e+12; expected 0 to 6000"),
        ("persons_per_min = inf", "persons_per_min: got inf; expected 0 to 6000"),
        ("persons_per_min = 12\ngroup_size = 1e9", "group_size: got 1e+09; expected 1 to 100"),
        ("persons_per_min = [[0, 1e300]]", "persons_per_min: got 1e+300; expected 0 to 6000"),
        ("persons_per_min = [[-1, 1]]", "ascending times"),
    ],
)
def test_additions_have_limits(added: str, said: str, tmp_path: Path) -> None:
    place = load_scene("plaza-v0")
    start = ", ".join(f"{x:g}" for x in read_areas(place).spawn.mean[0])
    path = tmp_path / "more.toml"
    path.write_text(
        f'schema = 1\nscene = "plaza-v0"\n[[add]]\nmean_m = [{start}]\nsd_m = [0.5, 0.5]\n'
        f"goals = {{ 0 = 1 }}\n{added}\n"
    )
    with pytest.raises(SettingError) as error:
        read_scenario(path, place, read_areas(place))
    assert said in str(error.value)


def test_there_are_not_too_many_additions(tmp_path: Path) -> None:
    place = load_scene("plaza-v0")
    start = ", ".join(f"{x:g}" for x in read_areas(place).spawn.mean[0])
    one = f"[[add]]\nmean_m = [{start}]\nsd_m = [1, 1]\npersons_per_min = 1\ngoals = {{ 0 = 1 }}\n"
    path = tmp_path / "more.toml"
    path.write_text('schema = 1\nscene = "plaza-v0"\n' + 101 * one)
    with pytest.raises(SettingError, match="got 101 additional areas; expected at most 100"):
        read_scenario(path, place, read_areas(place))


@pytest.mark.parametrize("horizon_s", [-1.0, 0.0, float("nan"), float("inf"), 1e9])
def test_an_episode_has_a_length(horizon_s: float) -> None:
    with pytest.raises(CrowdbenchError, match="expected a positive number of seconds, at most"):
        crowdbench.rollout("plaza-v0", "poisson-gmm", "straight", seed=0, horizon_s=horizon_s)
