"""The rays and the path of one chosen person."""

from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float32

from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import head_of
from crowdbench.simulation.state import GOAL
from crowdbench.viewer.crowd import time_columns
from crowdbench.viewer.place import SIMULATION, WORLD

_HIT, _FREE = (255, 235, 130, 200), (255, 235, 130, 50)
_WHITE = (255, 255, 255)


def index_of(person_id: int, crowd: Trajectories) -> int:
    """Index of a person in the table.

    Raises:
        SettingError: no person has this id.
    """
    found = np.flatnonzero(crowd.person_id == person_id)
    if not len(found):
        expected = f"an id from the table, {crowd.person_id.min()} to {crowd.person_id.max()}"
        hint = "The viewer shows ids in its log and next to the cursor."
        raise SettingError("person", got=str(person_id), expected=expected, hint=hint)
    return int(found[0])


def log_chosen(stream: rr.RecordingStream, crowd: Trajectories, scene: Scene, chosen: int) -> None:
    """Log the rays in each frame, and the complete path, of the person at index `chosen`."""
    settings = Settings(max_alive=int(crowd.present().max()))
    length = ray_lengths(crowd, chosen, scene, settings)
    path, first = crowd.path(chosen), crowd.first[chosen]
    shown = settings.shown
    angle = 2 * np.pi * np.arange(shown.rays) / shown.rays
    ends = path[:, None] + length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    strips = np.stack([np.broadcast_to(path[:, None], ends.shape), ends], axis=2)
    met = (length < shown.ray_range_m).ravel()

    def log(
        name: str, frames: np.ndarray, columns: Any, there: np.ndarray, look: rr.AsComponents
    ) -> None:
        where = f"{WORLD}/{SIMULATION}/chosen/{name}"
        times = time_columns(first + frames, crowd.dt_s)
        stream.send_columns(where, times, columns.partition(there))
        stream.log(where, look, static=True)

    # An additional frame without rays, so that they disappear with the person.
    each, count = np.arange(len(path) + 1), np.append(np.full(len(path), shown.rays), 0)
    rays = rr.LineStrips2D.columns(
        strips=strips.reshape(-1, 2, 2).astype(np.float32),
        colors=np.where(met[:, None], _HIT, _FREE).astype(np.uint8),
    )
    thin = rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(0.5), draw_order=0.0)
    log("rays", each, rays, count, thin)
    wide = rr.Points2D.from_fields(
        radii=1.5 * scene.motion.person_radius_m, colors=_WHITE, draw_order=1.5
    )
    log("ring", each, rr.Points2D.columns(positions=path), np.minimum(count, 1), wide)
    present, there = np.array([0, len(path)]), np.array([1, 0])
    way = rr.LineStrips2D.columns(strips=path[None])
    thin = rr.LineStrips2D.from_fields(
        radii=rr.Radius.ui_points(0.75), colors=_WHITE, draw_order=0.5
    )
    log("way", present, way, there, thin)
    what = "goal" if crowd.outcome[chosen] == GOAL else "end"
    end = rr.Points2D.columns(
        positions=path[-1:], labels=[f"{what} of person {crowd.person_id[chosen]}"]
    )
    dot = rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(4.0), colors=_WHITE, show_labels=True, draw_order=3.0
    )
    log("goal", present, end, there, dot)


def ray_lengths(
    crowd: Trajectories, chosen: int, scene: Scene, settings: Settings
) -> Float32[np.ndarray, "n R"]:
    """Lengths of the rays of the person at index `chosen`, in each frame of the trip, metres.

    They are computed by the kernel of the environment. As in the environment, people whose trip has
    just ended are not seen by others, and themselves do not see people who enter in that frame.
    """
    simulation = Simulation(scene, settings=settings)
    shown = settings.shown
    slots, head = simulation.slots, head_of(shown.observation)
    last, final = crowd.last, crowd.frames - 1
    seen = np.empty((len(crowd.path(chosen)), shown.rays), np.float32)
    for k, frame in enumerate(range(crowd.first[chosen], last[chosen] + 1)):
        here = np.flatnonzero((crowd.first <= frame) & (frame <= last))
        n = len(here)
        ends = (last[here] == frame) & crowd.left[here] & (frame < final)
        slots.alive[0] = slots.spawned[0] = slots.ended[0] = 0
        slots.alive[0, :n] = ~ends
        slots.ended[0, :n] = np.where(ends, GOAL, 0)
        slots.spawned[0, :n] = crowd.entered[here] & (crowd.first[here] == frame)
        slots.position[0, :n] = crowd.xy[crowd.offsets[here] + frame - crowd.first[here]]
        slot = int(np.searchsorted(here, chosen))
        seen[k] = simulation.observe()[0, slot, head : head + shown.rays]
    return seen * np.float32(shown.ray_range_m)
