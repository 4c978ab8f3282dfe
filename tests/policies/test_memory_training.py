"""The three documented ways to a policy with a memory lead to people who arrive, and to an entry.

The examples of docs/reinforcement-learning.md are run as they stand there, for one fold of the
plaza; its network is exported for the others, too.
"""

import copy
import hashlib
import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
import torch
from conftest import need_sb3
from submissions import FOLDS, PLAZA, fill_in
from torch import Tensor, nn

from crowdbench import rollout, spawn_model
from crowdbench.cli import main
from crowdbench.data.blocks import SPLITS
from crowdbench.data.storage import read_own
from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.entry import read_entry
from crowdbench.policies import Memory, OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.registry import import_recording
from crowdbench.scene import Scene

pytestmark = pytest.mark.nightly

PAGE = (pages.ROOT / "docs" / "reinforcement-learning.md").read_text()
ROUTES = {"plain": "parallel_env(", "torchrl": "SlotEnv(", "sb3": "RecurrentPPO("}
"""The words by which the page's example of each way is found."""
ENOUGH = 0.95
WIDTH = 0.05
Trained = tuple[Path, nn.Module, int]


class Sampler(nn.Module):
    """A network that draws its actions, as those are drawn that it has been trained with."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Tensor, noise: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        action, state = self.network(seen, state)
        return action + WIDTH * noise, state


class Compared:
    """The policy of a file, whose network in torch gets the same input, the same noise too."""

    name, sees, observation = "compared", "observation", "social-1"

    def __init__(self, file: OnnxPolicy, network: nn.Module) -> None:
        self.file, self.network = file, network
        self.memory = file.memory
        self.differences: list[float] = []

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.rng = copy.deepcopy(rng)
        self.file.reset(scene, rng)

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        noise = self.rng.standard_normal((len(seen), 2), dtype=np.float32)
        with torch.no_grad():
            told = self.network(*map(torch.tensor, (seen, noise, memory.state)))
        action = self.file.act(seen, memory)
        for one, other in zip(told, (action, memory.state), strict=True):
            self.differences.append(np.abs(one.numpy() - other).max(initial=0))
        return action


def train(route: str) -> tuple[nn.Module, int]:
    """Network of an example, and its memory; writes it to `results/gru`, for each fold."""
    first = FOLDS[0]
    world: dict[str, Any] = {"spawn_model": spawn_model}

    def run(words: str, old: str = "", new: str = "") -> None:
        code = pages.block_with(PAGE, words)
        assert old in code
        exec(compile(code.replace(old, new), "reinforcement-learning.md", "exec"), world)

    if route == "sb3":
        from crowdbench.policies.sb3 import read_sb3

        spawn = f'spawn=spawn_model("ntpp-gmm", "plaza-v0", "{first}")'
        run(ROUTES[route], '"plaza-v0", 32', f'"plaza-v0", 32, {spawn}')
        (command,) = (c for c in pages.commands(PAGE) if "recurrent.zip recurrent.onnx" in c)
        for split in FOLDS:
            asked = shlex.split(command.replace("recurrent.onnx", f"results/gru/{split}.onnx"))[1:]
            assert main([*asked, "--split", split]) == 0
        found = read_sb3(Path("recurrent.zip"))
        return found, found.memory
    run("class Recurrent")
    run(ROUTES[route], '"full"', f'"{first}"')
    for split in FOLDS:
        world["split"] = split
        run("export_policy(")
    return world["walker"], world["card"].memory


@pytest.fixture(scope="module", params=ROUTES)
def trained(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Trained]:
    """The folder where the network of a route was evaluated, the network, and its memory."""
    if request.param == "sb3":
        need_sb3()
    else:
        pytest.importorskip("torchrl")
    folder = tmp_path_factory.mktemp(request.param)
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(folder / "home"))
        patch.chdir(folder)
        patch.setattr("crowdbench.report.html.write_report", lambda *of, **more: None)
        import_recording("plaza")
        torch.set_num_threads(1)
        network, memory = train(request.param)
        asked = "plaza-v0 --policy results/gru --spawn ntpp-gmm --protocol heldout --out out"
        assert main(["evaluate", *asked.split(), "--seeds", "1", "--workers", "1"]) == 0
        yield folder, network, memory
        torch.set_num_threads(threads)


def evaluated(folder: Path) -> dict[str, Any]:
    """What the evaluation says of the networks, by spawn model."""
    entries = json.loads((folder / "out" / "scorecard.json").read_text())["entries"]
    return {entry["spawn"]: entry for entry in entries if entry["policy"].endswith("gru")}


def test_everyone_arrives_where_it_is_evaluated(trained: Trained) -> None:
    folder = trained[0]
    found = evaluated(folder)
    assert set(found) == {"ntpp-gmm", "replay"}
    assert min(entry["at_goal"] for entry in found.values()) >= ENOUGH
    # The evaluation's crowds, made by other processes, are those of the process that trained.
    for split in FOLDS:
        (file,) = (folder / "out" / "rollouts").glob(f"ntpp-gmm_results-gru*_{split}_0.parquet")
        told = read_own(file)
        spawn = spawn_model("ntpp-gmm", PLAZA, split, fit=int(told.provenance["fit"]))
        seed = int(told.provenance["seed"]) * len(SPLITS) + SPLITS.index(split)
        here = rollout(
            PLAZA, spawn, OnnxPolicy(folder / "results" / "gru" / f"{split}.onnx"), seed=seed
        )
        assert same_bytes(here, told)


def same_bytes(one: Trajectories, other: Trajectories) -> bool:
    return one.xy.tobytes() == other.xy.tobytes() and bool((one.offsets == other.offsets).all())


def test_noise_is_drawn_alike_in_torch_and_in_the_file(trained: Trained) -> None:
    folder, network, memory = trained
    sampler = Sampler(network)
    card = PolicyCard(
        name="noisy", scene="plaza-v0", split="fold0", observation="social-1", memory=memory
    )
    file = export_policy(sampler, folder / "noisy.onnx", card, noise=2)
    asked = {"seed": 0, "horizon_s": 120.0}
    spawn = spawn_model("ntpp-gmm", PLAZA, "fold0")
    crowd = rollout(PLAZA, spawn, OnnxPolicy(file), **asked)
    both = Compared(OnnxPolicy(file), sampler)
    assert same_bytes(crowd, rollout(PLAZA, spawn, both, **asked))
    # torch and onnxruntime add in another order. Positions are not compared: among people who
    # avoid each other, the last digit of an action grows within a minute.
    assert len(both.differences) > 100
    assert max(both.differences) < 1e-5
    calm = rollout(PLAZA, spawn, OnnxPolicy(folder / "results" / "gru" / "fold0.onnx"), **asked)
    assert len(calm.xy) != len(crowd.xy) or np.abs(calm.xy - crowd.xy).max() > 0.1
    # The file itself gives the same bytes in every process.
    code = (
        "from crowdbench import rollout, spawn_model; import hashlib; "
        f"crowd = rollout('plaza-v0', spawn_model('ntpp-gmm', 'plaza-v0', 'fold0'), {str(file)!r}, "
        "seed=0, horizon_s=120.0); print(hashlib.sha256(crowd.xy.tobytes()).hexdigest())"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == hashlib.sha256(crowd.xy.tobytes()).hexdigest()


def test_it_becomes_an_entry(trained: Trained) -> None:
    folder = trained[0]
    submit = ["submit", "init", "mine", "--track", "walk", "--policy", "results/gru"]
    assert main(submit) == 0
    fill_in(folder / "mine")
    assert main(["submit", "check", "mine"]) == 0
    assert main(["leaderboard", "verify", "mine", "--out", "entries", "--workers", "1"]) == 0
    (file,) = (folder / "entries").glob("*[!n].json")
    entry = read_entry(file)
    assert entry.status == "ranked"
    in_sandbox, outside = entry.scenes["plaza-v0"], evaluated(folder)["replay"]
    assert in_sandbox.rollouts == 1  # of each fold, because its actions are not drawn
    assert in_sandbox.at_goal is not None
    assert in_sandbox.at_goal >= ENOUGH
    for name in ("at_goal", "speed_mps", "persons", "outcomes"):
        assert getattr(in_sandbox, name) == outside[name]
