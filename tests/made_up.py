"""A yard that no scene knows: people of a made-up process, written in every format."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from msgspec import structs
from worlds import box

from crowdbench.data.recordings.jupedsim import write_jupedsim
from crowdbench.data.recordings.trajnet import write_trajnet
from crowdbench.data.storage import write_csv
from crowdbench.data.table import Trajectories
from crowdbench.policies.social_force import PUBLISHED, SocialForce
from crowdbench.run.rollout import rollout
from crowdbench.scene import Bounds, Scene, Wall, load_scene
from crowdbench.spawn import Areas, RenewalGMM
from crowdbench.spawn.areas import Gaussians

DT_S = 0.4
BOUNDS = Bounds(0.0, 14.0, 0.0, 10.0)
WALLS = (
    Wall("north-west block", box(0.0, 5.0, 5.0, 10.0)),
    Wall("north-east block", box(9.0, 5.0, 14.0, 10.0)),
    Wall("well", ((7.0, 3.2), (7.4, 2.8), (7.0, 2.4), (6.6, 2.8))),
)
_DOORS = np.array([[1.0, 2.5], [13.0, 2.5], [7.0, 9.0]])


def yard() -> Scene:
    """A T of three ways that meet around a well."""
    eth = load_scene("eth-v0")
    return replace(
        eth,
        id="yard-v0",
        bounds=BOUNDS,
        walls=WALLS,
        motion=structs.replace(eth.motion, body_radius_m=0.0),
        recording=structs.replace(eth.recording, dwell_p99_s=30.0),
    )


def record(seconds: float = 300.0, *, every_s: float = 6.0, seed: int = 0) -> Trajectories:
    """What a camera over the yard saw: groups that come in bursts and walk by social forces."""
    doors = Gaussians(_DOORS, np.stack([np.diag([0.05, 0.2])] * 2 + [np.diag([0.2, 0.05])]))
    areas = Areas(
        scene="yard-v0",
        spawn=doors,
        goal=doors,
        flow=np.array([[0.0, 0.7, 0.3], [0.6, 0.0, 0.4], [0.5, 0.5, 0.0]]),
        speed_quantiles=np.linspace(0.9, 1.6, 101),
        left_out=(0.0, 0.0),
    )
    process = RenewalGMM(
        areas=areas,
        shape=np.full(3, 0.7),
        scale_s=np.full(3, every_s),
        next_member=np.full(3, 0.3),
        grid_s=DT_S,
    )
    crowd = rollout(yard(), process, SocialForce(PUBLISHED), seed=seed, horizon_s=seconds)
    return replace(crowd, scene="yard")


def write(crowd: Trajectories, layout: str, folder: Path) -> Path:
    """The crowd as a file, or a folder of files, in one of `own.FORMATS`."""
    path = folder / f"yard-{layout}{_SUFFIX[layout]}"
    _WRITE[layout](crowd, path)
    return path


def _obsmat(crowd: Trajectories, path: Path) -> None:
    """Every tenth frame of a video of 25 a second, with velocities."""
    lines = []
    for p, person in enumerate(crowd.person_id.tolist()):
        way = crowd.path(p).astype(float)
        v = np.gradient(way, DT_S, axis=0) if len(way) > 1 else np.zeros_like(way)
        for k, ((x, y), (vx, vy)) in enumerate(zip(way, v, strict=True)):
            frame = 10 * (crowd.first[p] + k)
            lines.append(f"{frame} {person} {x:.4f} 0.0 {y:.4f} {vx:.4f} 0.0 {vy:.4f}")
    path.write_text("\n".join([*lines, ""]))


def _gc(crowd: Trajectories, path: Path) -> None:
    """A pixel is a centimetre; every second frame of the scene is annotated."""
    (path / "Annotation").mkdir(parents=True)
    unit = 0.01 / 0.8
    matrix = [[0.0, unit, 0.0], [unit, 0.0, 0.0], [0.0, 0.0, 1.0]]
    (path / "H.json").write_text(json.dumps({"homog": matrix}))
    for p, person in enumerate(crowd.person_id.tolist()):
        frames = np.arange(crowd.first[p], crowd.last[p] + 1)
        pixels = np.round(crowd.path(p) * 100).astype(int)
        rows = [[*at, 10 * f] for at, f in zip(pixels, frames, strict=True) if f % 2 == 0]
        if rows:
            text = "\n".join(f"{column}\n{row}\n{frame}" for column, row, frame in rows)
            (path / "Annotation" / f"{person:06}.txt").write_text(text)


def _forum(crowd: Trajectories, path: Path) -> None:
    """Tracks in the pixels of the Forum's camera, nine times a second."""
    tracks = []
    for p in range(len(crowd)):
        ticks = np.arange(
            np.ceil(crowd.first[p] * DT_S * 9), np.floor(crowd.last[p] * DT_S * 9) + 1
        )
        times = np.arange(crowd.first[p], crowd.last[p] + 1) * DT_S
        x, y = (np.interp(ticks / 9, times, crowd.path(p)[:, k]) for k in (0, 1))
        if len(ticks):
            tracks.append((x / 0.0247, 480 - y / 0.0247, ticks))
    lines = [f"% Total number of trajectories in file are {len(tracks)}"]
    for number, track in enumerate(tracks, start=1):
        rows = ";".join(f"[{x:.0f} {y:.0f} {t:.0f}]" for x, y, t in zip(*track, strict=True))
        lines += [f"Properties.R{number}= [{len(track[0])} ];", f"TRACK.R{number}=[{rows}];"]
    path.write_text("\n".join(lines))


_WRITE = {
    "obsmat": _obsmat,
    "gc": _gc,
    "forum": _forum,
    "csv": write_csv,
    "trajnet": write_trajnet,
    "jupedsim": write_jupedsim,
}
_SUFFIX = {
    "obsmat": ".txt",
    "gc": "",
    "forum": ".txt",
    "csv": ".csv",
    "trajnet": ".ndjson",
    "jupedsim": ".txt",
}
SAID = {"obsmat": DT_S, "csv": DT_S}
"""Seconds from row to row that must be told; other formats say them."""
