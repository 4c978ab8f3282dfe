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
    """The crowd as a file, or a folder of files, in one of `formats.FORMATS`."""
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


def rows_of(crowd: Trajectories) -> list[tuple[int, int, float, float]]:
    """Person, frame, x and y of each row."""
    ids = crowd.person_id[crowd.row_person()].tolist()
    xy = crowd.xy.astype(np.float64).round(4).tolist()
    return [(p, f, x, y) for p, f, (x, y) in zip(ids, crowd.row_frame().tolist(), xy, strict=True)]


def _frame_ped_xy(crowd: Trajectories, path: Path) -> None:
    """Every tenth frame of a video, in the order of time."""
    rows = sorted((10 * f, p, x, y) for p, f, x, y in rows_of(crowd))
    path.write_text("".join(f"{f}.0\t{p}.0\t{x}\t{y}\n" for f, p, x, y in rows))


def _vsp(crowd: Trajectories, path: Path) -> None:
    """A control point in each frame of the scene; rows of the image go down along x."""
    lines = [f"{len(crowd)} - the number of splines"]
    for p in range(len(crowd)):
        way = crowd.path(p).astype(float)
        lines.append(f"{len(way)} - Num of control points")
        for k, (x, y) in enumerate(way):
            column, row = y / PIXEL_M - 360, 288 - x / PIXEL_M
            frame = 10 * (crowd.first[p] + k)
            lines.append(f"{column:.3f} {row:.3f} {frame} 90.0 - (2D point, m_id)")
    path.write_text("\n".join(lines))


def _sdd(crowd: Trajectories, path: Path) -> None:
    """Boxes of 10 by 20 pixels every 12 frames of a video of 30 a second; and a cyclist."""
    lines = ['99 0 0 10 10 0 0 0 0 "Biker"', '98 0 0 10 10 0 1 0 0 "Pedestrian"']
    for p, f, x, y in rows_of(crowd):
        column, row = x / PIXEL_M, y / PIXEL_M
        box = f"{column - 5:.3f} {row - 10:.3f} {column + 5:.3f} {row + 10:.3f}"
        lines.append(f'{p} {box} {12 * f} 0 0 0 "Pedestrian"')
    path.write_text("\n".join(lines))


def _sumo(crowd: Trajectories, path: Path) -> None:
    """Persons and a car by time step."""
    steps: dict[int, list[str]] = {frame: [] for frame in range(crowd.frames)}
    for p, f, x, y in rows_of(crowd):
        steps[f].append(f'<person id="p{p}" x="{x}" y="{y}" speed="1.3" edge="e0"/>')
    lines = ['<?xml version="1.0"?>', "<fcd-export>"]
    for frame, persons in steps.items():
        lines.append(f'<timestep time="{frame * DT_S:.2f}"><vehicle id="v" x="0" y="0"/>')
        lines += [*persons, "</timestep>"]
    path.write_text("\n".join([*lines, "</fcd-export>"]))


def _vadere(crowd: Trajectories, path: Path) -> None:
    lines = ["pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1"]
    for p, f, x, y in rows_of(crowd):
        lines.append(f"{p} {f * DT_S:.2f} {(f + 1) * DT_S:.2f} {x} {y} {x} {y}")
    path.write_text("\n".join([*lines, ""]))


def _hdf5(crowd: Trajectories, path: Path) -> None:
    import h5py

    kinds = [("id", "i4"), ("frame", "i4"), ("x", "f8"), ("y", "f8"), ("z", "f8")]
    with h5py.File(path, "w") as file:
        data = np.array([(*row, 0.0) for row in rows_of(crowd)], dtype=kinds)
        file.create_dataset("trajectory", data=data).attrs["fps"] = 1 / DT_S


def _timed(crowd: Trajectories) -> list[tuple[int, float, float, float]]:
    """Person, time, x and y every half frame: PedPy takes whole numbers of rows per second."""
    found = []
    for p, person in enumerate(crowd.person_id.tolist()):
        way, first = crowd.path(p).astype(np.float64), int(crowd.first[p])
        half = np.arange(0, len(way) - 0.75, 0.5)
        x, y = (np.interp(half, np.arange(len(way)), way[:, k]).round(4).tolist() for k in (0, 1))
        times = ((first + half) * DT_S).round(2).tolist()
        found += [(person, *row) for row in zip(times, x, y, strict=True)]
    return found


def _viswalk(crowd: Trajectories, path: Path) -> None:
    lines = ["$VISION", "* a comment", "$PEDESTRIAN:NO;SIMSEC;COORDCENTX;COORDCENTY"]
    lines += [f"{p};{t};{x};{y}" for p, t, x, y in _timed(crowd)]
    path.write_text("\n".join([*lines, ""]))


def _pathfinder(crowd: Trajectories, path: Path) -> None:
    lines = ["name,id,t,x,y", ",,s,m,m"]
    lines += [f"someone,{p},{t},{x},{y}" for p, t, x, y in _timed(crowd)]
    path.write_text("\n".join([*lines, ""]))


def _crowdit(crowd: Trajectories, path: Path) -> None:
    rows = [f"{p},{t},{x},{y}" for p, t, x, y in _timed(crowd)]
    path.write_text("\n".join(["pedID,time,posX,posY", *rows, ""]))


_WRITE = {
    "obsmat": _obsmat,
    "gc": _gc,
    "forum": _forum,
    "csv": write_csv,
    "trajnet": write_trajnet,
    "jupedsim": write_jupedsim,
    "frame-ped-xy": _frame_ped_xy,
    "vsp": _vsp,
    "sdd": _sdd,
    "sumo": _sumo,
    "vadere": _vadere,
    "hdf5": _hdf5,
    "viswalk": _viswalk,
    "pathfinder": _pathfinder,
    "crowdit": _crowdit,
}
_SUFFIX = {
    "obsmat": ".txt",
    "gc": "",
    "forum": ".txt",
    "csv": ".csv",
    "trajnet": ".ndjson",
    "jupedsim": ".txt",
    "frame-ped-xy": ".txt",
    "vsp": ".vsp",
    "sdd": ".txt",
    "sumo": ".xml",
    "vadere": ".traj",
    "hdf5": ".h5",
    "viswalk": ".pp",
    "pathfinder": ".csv",
    "crowdit": ".csv",
}
PIXEL_M = 0.02
"""Size of a pixel in the formats that have pixels and leave open what they are."""
SCALES = {"vsp": PIXEL_M, "sdd": PIXEL_M}
SAID = {"obsmat": DT_S, "csv": DT_S, "frame-ped-xy": DT_S}
"""Seconds from row to row that must be told; other formats say them."""
