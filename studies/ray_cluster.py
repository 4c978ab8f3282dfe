"""An evaluation on a Ray cluster of three nodes of this machine, one of which is killed.

    python -m studies ray-cluster plaza-v0
    python -m studies ray-cluster eth-v0 --protocol heldout

All arguments are those of `crowdbench evaluate`. It compares the bytes of the scorecard and of all
rollouts with those of `--workers 1`. It needs the extra `ray`.
"""

import filecmp
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import ray
from ray.cluster_utils import Cluster

from crowdbench import cli

NODES = 3


def kill_later(cluster: Cluster, node: Any, out: Path) -> None:
    """Kill a node as soon as the first rollouts are there."""
    while not any((out / "rollouts").glob("*.parquet")):
        time.sleep(0.05)
    cluster.remove_node(node, allow_graceful=False)
    print(f"killed a node after {len(list((out / 'rollouts').glob('*.parquet')))} rollouts")


def same(one: Path, other: Path) -> bool:
    """Whether two results have the same scorecard and rollouts."""
    names = sorted(str(path.relative_to(one)) for path in one.glob("rollouts/*.parquet"))
    others = sorted(str(path.relative_to(other)) for path in other.glob("rollouts/*.parquet"))
    assert names == others, set(names) ^ set(others)
    assert names
    wrong = filecmp.cmpfiles(one, other, ["scorecard.json", *names], shallow=False)[1:]
    print(f"{len(names)} rollouts and the scorecard: {'other bytes in ' if any(wrong) else 'same'}",
          *wrong[0], *wrong[1])  # fmt: skip
    return not any(wrong)


def compare(arguments: list[str]) -> bool:
    """Evaluate twice; whether the node was lost and the bytes are the same."""
    with tempfile.TemporaryDirectory() as folder:
        here, there = Path(folder) / "here", Path(folder) / "there"
        began = time.monotonic()
        assert (
            cli.main(
                ["evaluate", *arguments, "--keep-rollouts", "--out", str(here), "--workers", "1"]
            )
            == 0
        )
        print(f"--workers 1: {time.monotonic() - began:.0f} s")
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        others = [cluster.add_node(num_cpus=1) for _ in range(NODES - 1)]
        os.environ["RAY_ADDRESS"] = cluster.address
        threading.Thread(target=kill_later, args=(cluster, others[0], there), daemon=True).start()
        began = time.monotonic()
        assert (
            cli.main(
                ["evaluate", *arguments, "--keep-rollouts", "--out", str(there), "--engine", "ray"]
            )
            == 0
        )
        ray.init(address=cluster.address, log_to_driver=False)
        left = sum(node["Alive"] for node in ray.nodes())
        print(f"{NODES} nodes, of which {left} are left: {time.monotonic() - began:.0f} s")
        ray.shutdown()
        cluster.shutdown()
        return left == NODES - 1 and same(here, there)
