"""The engine `ray`: the same results, own code, files there and back, dead nodes and interrupts."""

import os
import shlex
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pages
import pytest
from conftest import need
from submissions import declare

from crowdbench import cli
from crowdbench.errors import SettingError
from crowdbench.run import executor, ray_executor

ROOT = Path(__file__).parents[2]

OWN = '''
"""Tasks, and a policy, of a user."""
import os, time
from pathlib import Path
import numpy as np
import crowdbench

def half(number, out, by):
    """Append to a file of the task; 13 is bad luck."""
    if number == 13:
        raise ValueError("thirteen")
    time.sleep(0.2)
    path = out / f"{number}.txt"
    before = path.read_text() if path.exists() else ""
    path.write_text(before + f"{number / by}")
    return number / by, str(path), Path("given.txt").read_text(), os.environ["CROWDBENCH_HOME"], (
        crowdbench.__file__
    )

class Slow:
    """Walks slowly to the target."""
    name, sees = "slow", "observation"
    def reset(self, scene, rng):
        pass
    def act(self, seen):
        return (0.5 * seen[:, 2:4]).astype(np.float32)
'''

CLUSTER = """
import os, threading, time
import ray
from ray.cluster_utils import Cluster
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
os.environ["RAY_ADDRESS"] = cluster.address
"""


def run(script: str, folder: Path) -> str:
    """Output of a script that runs in a folder with a module `own` of the user."""
    need(find_spec("ray"), "the extra ray")
    (folder / "own.py").write_text(OWN)
    (folder / "given.txt").write_text("given")
    (folder / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=folder, capture_output=True, text=True, timeout=400,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.nightly
def test_a_dead_node_an_error_and_an_interrupt(tmp_path: Path) -> None:
    out = run(
        CLUSTER
        + """
from contextlib import closing
from pathlib import Path
import crowdbench, own
from crowdbench.run.executor import call_each, checked_workers
out = Path("out")
out.mkdir()
(out / "2.txt").write_text("before ")
given = dict(files=lambda n, out: [out / f"{n}.txt"], reads=lambda n, out: [Path("given.txt")])
with crowdbench.engine("ray"):
    assert checked_workers(None) == 3
    found = {}
    for k, result in call_each(own.half, [(n, out) for n in range(12)], 3, common=(2,), **given):
        found[k] = result
        if len(found) == 2:
            cluster.remove_node(nodes[0], allow_graceful=False)
    assert sorted(found) == list(range(12))
    for k, (number, path, text, home, code) in found.items():
        assert (number, text) == (k / 2, "given")
        assert Path(home).parent.name.startswith("crowdbench-tmp-node-")
        assert "py_modules_files" in code
        assert not Path(path).exists() or out not in Path(path).parents
        assert (out / f"{k}.txt").read_text() == ("before 1.0" if k == 2 else f"{k / 2}")
    try:
        list(call_each(own.half, [(13, out)], 1, common=(2,), **given))
    except ValueError as error:
        assert "thirteen" in str(error)
        assert "own.py" in error.__notes__[0]
    with closing(call_each(own.half, [(n, out) for n in range(50)], 2, common=(2,), **given)) as c:
        next(c)
    for _ in range(300):
        free, alive = ray.available_resources().get("CPU"), sum(n["Alive"] for n in ray.nodes())
        if (free, alive) == (2, 2):
            break
        time.sleep(0.1)
    print("free:", free, "alive:", alive, flush=True)
assert not ray.is_initialized()
cluster.shutdown()
""",
        tmp_path,
    )
    assert "free: 2.0 alive: 2" in out


@pytest.mark.nightly
def test_an_evaluation_has_the_bytes_of_one_core(tmp_path: Path) -> None:
    out = run(
        """
import filecmp, shutil
from pathlib import Path
import ray
import crowdbench
from crowdbench.scene import scenes_folder
shutil.copytree(scenes_folder() / "plaza-v0", "mine")
shutil.copy(scenes_folder() / "eth-v0" / "policies" / "bc" / "full.onnx", "walker.onnx")
what = dict(spawn=["poisson-gmm", "replay"], policy=["own:Slow", "walker.onnx"], seeds=2)
crowdbench.evaluate("mine", **what, workers=1, out="here")
with crowdbench.engine("ray"):
    for _ in range(2):  # once more, from the files that are there
        crowdbench.evaluate("mine", **what, out="there")
names = sorted(str(path.relative_to("here")) for path in Path("here").glob("rollouts/*.parquet"))
different = filecmp.cmpfiles("here", "there", ["scorecard.json", *names], shallow=False)[1:]
print(len(names), "same" if not any(different) else different)
""",
        tmp_path,
    )
    assert out.split()[-1] == "same", out


@pytest.mark.nightly
def test_the_collectors_of_the_page_collect(tmp_path: Path) -> None:
    (example,) = (
        block
        for block in pages.blocks((ROOT / "docs" / "cluster.md").read_text(), "python")
        if "RayCollector" in block
    )
    here = '{"address": "local", "num_cpus": 2, "include_dashboard"'
    local = example.replace('{"include_dashboard"', here)
    assert local != example
    out = run(local, tmp_path)
    assert out.count(" steps, reward ") == 4


@pytest.mark.nightly
def test_submissions_are_verified_on_a_cluster(tmp_path: Path) -> None:
    for name in ("good", "bad"):
        shipped = 'shipped_policy = "straight"' if name == "good" else 'shipped_policy = "nobody"'
        declare(tmp_path / name, more=shipped)
    out = run(
        """
import ray
from pathlib import Path
import crowdbench
from crowdbench.leaderboard.verification.verify import verify, verify_each
ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
with crowdbench.engine("ray"):
    found = dict(verify_each([Path("good"), Path("bad")], Path("there")))
print("nobody" in str(found[Path("bad")]), len(list(Path("there").glob("*.json*"))))
entry, _ = verify(Path("good"), Path("here"), workers=1)
here, there = (Path(f"{folder}/{entry.id}.json.gz").read_bytes() for folder in ("here", "there"))
same = here == there
print("same" if same else "different")
""",
        tmp_path,
    )
    assert out.split()[-3:] == ["True", "2", "same"], out


def test_the_commands_of_the_page_exist() -> None:
    commands = pages.commands((ROOT / "docs" / "cluster.md").read_text())
    assert len(commands) >= 3
    for command in commands:
        _, bound, _ = cli.app.parse_args(shlex.split(command)[1:], exit_on_error=False)
        assert bound.arguments.get("engine", "local") in ("local", "ray")


def test_an_unknown_engine_is_named() -> None:
    with pytest.raises(SettingError, match="ray://HOST:PORT"), executor.engine("slurm"):
        pass
    with pytest.raises(SettingError, match="set RAY_ADDRESS=HOST:PORT"), executor.engine("a:6379"):
        pass


def test_no_cluster_at_the_address() -> None:
    need(find_spec("ray"), "the extra ray")
    done = subprocess.run(
        [sys.executable, "-m", "crowdbench", "scene", "anchors", "plaza-v0", "--engine", "ray://127.0.0.1:1"],
        capture_output=True, text=True, cwd=ROOT, timeout=120,
        env=os.environ | {"RAY_CLIENT_RECONNECT_GRACE_PERIOD": "1"},
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "ray start --head" in done.stderr
    assert "refused" in done.stderr


def test_the_engine_ends_with_the_block() -> None:
    with executor.engine("local"):
        assert executor.is_local()
        assert executor.checked_workers(3) == 3


def test_what_is_sent_to_nodes_is_as_in_a_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    for name in ("own.py", "inside/other.py", "data.txt", "results/a.py", ".b/c.py"):
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).touch()
    monkeypatch.chdir(here)
    (tmp_path / "node").mkdir()
    env = ray_executor._code(tmp_path / "node")
    working = Path(env["working_dir"])
    sent = {str(p.relative_to(working)) for p in working.rglob("*") if p.is_file()}
    assert sent == {"own.py", "inside/other.py"}
    assert env["py_modules"] == [str(tmp_path / "node" / "crowdbench")]
    code = (
        "import crowdbench, crowdbench.baselines.heuristic as found; print(found.__file__); "
        "print(len(crowdbench.list_scenes()))"
    )
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = [sys.executable, "-c", f"import sys; sys.path.insert(0, '../node'); {code}"]
    done = subprocess.run(run, cwd=here, env=plain, capture_output=True, text=True, check=True)
    file, scenes = done.stdout.split()
    assert Path(file) == here / "../node/crowdbench/baselines/heuristic.py"
    assert int(scenes) >= 6


def test_files_outside_the_working_directory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    (here / "own.onnx").touch()
    monkeypatch.chdir(here)
    assert ray_executor._place(Path("own.onnx")) == Path("own.onnx")
    for path in (Path("../here/own.onnx"), here / "own.onnx", Path("../own.onnx")):
        with pytest.raises(SettingError, match="relative to it"):
            ray_executor._place(path)


@pytest.mark.nightly
def test_whoever_asks_it_to_end_is_answered_in_order(tmp_path: Path) -> None:
    need(find_spec("ray"), "the extra ray")
    out = tmp_path / "out"
    asked = ["evaluate", "plaza-v0", "--spawn", "poisson-gmm", "--policy", "straight"]
    asked += ["--seeds", "2000", "--engine", "ray", "--out", str(out)]
    with subprocess.Popen(
        [sys.executable, "-m", "crowdbench", *asked],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, cwd=ROOT,
    ) as running:  # fmt: skip
        until = time.monotonic() + 240
        while not list(out.glob("rollouts/*")) and running.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.5)
        running.terminate()
        _, said = running.communicate(timeout=60)
    assert running.returncode == 143, said
    assert "crowdbench: stopped" in said
