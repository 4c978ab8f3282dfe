"""The door of the exam, walked by JuPedSim.

JuPedSim needs an environment of its own, in which crowdbench is not installed:

    python -m studies.jupedsim_door write door.json
    python -m venv jupedsim && jupedsim/bin/pip install jupedsim
    jupedsim/bin/python studies/jupedsim_door.py run door.json
    crowdbench exam --test door --policy straight speed-model social-force

`write` writes the room and its people to a file, for each of the exam's seeds. `run` walks them
with JuPedSim's `CollisionFreeSpeedModel` and its default parameters, from the same starts and with
the same preferred speeds, and prints a line of a table. The exam does so with policies of
crowdbench.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

Room = dict[str, Any]

HEAD = (
    "| | people out | flow, 1/(m s) | last out, s | least distance, m |\n|---|---:|---:|---:|---:|"
)


def write(file: Path) -> None:
    """Write the room and its people."""
    from crowdbench.exam import TRIALS
    from crowdbench.exam.rooms import SPEED_MPS, door_room
    from crowdbench.scene import load_scene

    place = load_scene("eth-v0")
    rooms = [door_room(place, np.random.default_rng(k)) for k in range(TRIALS["door"].seeds)]
    scene, bounds = rooms[0].scene, rooms[0].scene.bounds
    described = {
        "bounds": [bounds.x_min_m, bounds.y_min_m, bounds.x_max_m, bounds.y_max_m],
        "walls": [wall.corners_m for wall in scene.walls],
        "line_x": rooms[0].line[0] if rooms[0].line else None,
        "horizon_s": rooms[0].horizon_s,
        "speed_mps": SPEED_MPS,
        "crowds": [
            {"start": of.people.start.tolist(), "goal": of.people.goal.tolist()} for of in rooms
        ],
    }
    file.write_text(json.dumps(described))


def run(file: Path) -> None:
    """Walk the people with JuPedSim."""
    import jupedsim

    room = json.loads(file.read_text())
    print(HEAD)
    out, flow, last, least = np.array([_walk(room, crowd) for crowd in room["crowds"]]).T
    print(
        f"| JuPedSim {jupedsim.__version__} | {out.mean():.0f} [{out.min():.0f}, {out.max():.0f}] "
        f"| {flow.mean():.2f} [{flow.min():.2f}, {flow.max():.2f}] "
        f"| {'never' if np.isnan(last).any() else f'{last.max():.0f}'} | {least.min():.2f} |"
    )


def _walk(room: Room, crowd: Room) -> tuple[float, ...]:
    """People out, flow as `flow_per_s` of the exam, time of the last (or NaN), least distance."""
    import jupedsim
    from shapely import Polygon, box, union_all

    area = box(*room["bounds"]) - union_all([Polygon(wall) for wall in room["walls"]])
    dt_s = 0.01
    simulation = jupedsim.Simulation(
        model=jupedsim.CollisionFreeSpeedModel(), geometry=area, dt=dt_s
    )
    agents = []
    for start, goal in zip(crowd["start"], crowd["goal"], strict=True):
        # Each person has a goal of its own, where it leaves.
        exit_ = simulation.add_exit_stage(box(goal[0] - 0.3, goal[1] - 0.3, goal[0] + 0.3,
                                              goal[1] + 0.3))  # fmt: skip
        journey = simulation.add_journey(jupedsim.JourneyDescription([exit_]))
        parameters = jupedsim.CollisionFreeSpeedModelAgentParameters(
            position=tuple(start), desired_speed=room["speed_mps"], journey_id=journey,
            stage_id=exit_,
        )  # fmt: skip
        agents.append(simulation.add_agent(parameters))
    passed: dict[int, float] = {}
    least = np.inf
    for step in range(round(room["horizon_s"] / dt_s)):
        simulation.iterate()
        if step % 40 == 39:  # as often as crowdbench's rooms are measured
            at = np.array([agent.position for agent in simulation.agents()])
            if len(at) > 1:
                apart = np.linalg.norm(at[:, None] - at, axis=2)[np.triu_indices(len(at), 1)]
                least = min(least, float(apart.min()))
            for agent in simulation.agents():
                if agent.position[0] >= room["line_x"]:
                    passed.setdefault(agent.id, (step + 1) * dt_s)
        if simulation.agent_count() == 0:
            break
    times = np.sort(list(passed.values()))
    first, end = int(0.1 * len(times)), int(0.9 * len(times)) - 1
    flow = (end - first) / (times[end] - times[first]) if len(times) >= 10 else np.nan
    last = times[-1] if len(times) == len(agents) else np.nan
    return len(times), float(flow), float(last), least


def main() -> None:
    """Run one of the two parts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("write", "run"))
    parser.add_argument("file", type=Path, help="the room")
    asked = parser.parse_args()
    (write if asked.part == "write" else run)(asked.file)


if __name__ == "__main__":
    main()
