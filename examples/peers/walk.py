"""Walks the people of the recordings with each model, as published or calibrated.

A table of each rollout is kept in `results/peers`, beside what could not be done as asked (the
counts of the adapter), so an interrupted call is continued.
"""

import inspect
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Literal

from crowdbench.data.blocks import SPLITS
from crowdbench.data.storage import write_parquet
from crowdbench.files import sha256, write_text
from crowdbench.registry import spawn_model
from crowdbench.registry.recordings import recording_hash
from crowdbench.run.resolved import code_of_rollouts
from crowdbench.run.rollout import rollout, seed_of
from crowdbench.scene import Scene, load_scene

from .calibrated import parameters_of
from .models import MODELS, Peer

OUT = Path("results/peers")
FEW = 2
"""Number of rollouts of a model that draws random numbers: the fewest that have a score. Those of
the anticipation velocity model are used only when two people stand in each other's way."""
Column = Literal["published", "calibrated"]
_HERE = Path(__file__).parent
_LIBRARIES = ("jupedsim", "PySocialForce", "pyrvo")


@dataclass(frozen=True)
class Walk:
    """A rollout that is wanted."""

    scene: str
    model: str
    column: Column
    split: str
    seed: int

    @property
    def path(self) -> Path:
        """Its table."""
        name = f"{self.model}-{self.column}-{self.split}-{self.seed}.parquet"
        return OUT / self.scene / name

    @property
    def parameters(self) -> Mapping[str, float]:
        """Other parameters than the published ones."""
        if self.column == "published":
            return {}
        return parameters_of(self.model, self.scene, self.split)


def wanted(scenes: Sequence[str], models: Sequence[str], column: Column) -> list[Walk]:
    """The rollouts of some models: for each fold if they are calibrated, otherwise once."""
    found = []
    for scene in scenes:
        for model in models:
            seeds = 1 if MODELS[model].deterministic else FEW
            splits = SPLITS[:1] if column == "published" else SPLITS[1:]
            found += [Walk(scene, model, column, s, k) for s in splits for k in range(seeds)]
    return found


def make(walks: Sequence[Walk], workers: int) -> None:
    """Make the tables that are missing."""
    missing = [walk for walk in walks if not _is_made(walk)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(_made, walk): walk for walk in missing}
        for done, future in enumerate(as_completed(jobs), 1):
            counts, walk = future.result(), jobs[future]
            told = ", ".join(f"{n} {name}" for name, n in counts.items() if n)
            print(f"{done} of {len(missing)}: {walk.path.stem} on {walk.scene}: {told}", flush=True)


def counts_of(walk: Walk) -> dict[str, int]:
    """The counts of the adapter in a rollout that is made."""
    return json.loads(_facts(walk).read_text())["counts"]


def _made(walk: Walk) -> dict[str, int]:
    place, peer = load_scene(walk.scene), MODELS[walk.model](walk.parameters)
    began = time.process_time()
    seed = seed_of(walk.split, walk.seed)
    crowd = rollout(place, spawn_model("replay", place), peer, seed=seed)
    cpu_s = round(time.process_time() - began, 1)
    write_parquet(crowd, walk.path)
    facts = {"made_from": _key(walk, place), "cpu_s": cpu_s, "counts": peer.counts}
    write_text(_facts(walk), json.dumps(facts))
    return peer.counts


def _facts(walk: Walk) -> Path:
    return walk.path.with_suffix(".json")


def _is_made(walk: Walk) -> bool:
    if not (walk.path.exists() and _facts(walk).exists()):
        return False
    return json.loads(_facts(walk).read_text())["made_from"] == _key(walk, load_scene(walk.scene))


def _key(walk: Walk, place: Scene) -> str:
    """Hash of all that a rollout depends on."""
    told = json.dumps([walk.model, dict(walk.parameters), walk.split, walk.seed])
    parts = [key_of(place, MODELS[walk.model]), told, recording_hash(place)]
    return sha256(" ".join(parts).encode())[:16]


def key_of(place: Scene, kind: type[Peer]) -> str:
    """Hash of a scene's rules, of the code of crowdbench and the adapter, and of the libraries."""
    sources = [(_HERE / name).read_bytes() for name in ("adapter.py", kind.adapted_in)]
    sources += [inspect.getsource(getattr(kind, name)).encode() for name in ("crowd", "reset")]
    parts = [place.rules, code_of_rollouts(foreign=True).encode(), *sources]
    parts += [f"{name} {version(name)}".encode() for name in _LIBRARIES]
    return sha256(b" ".join(sha256(part).encode() for part in parts))[:16]
