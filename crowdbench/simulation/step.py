"""The kernel of a step: move people, end trips, let people enter."""

import math

import numpy as np
from numba import prange

from crowdbench.compilation import Kernel, subroutine
from crowdbench.data.stops import STANDING_MPS
from crowdbench.simulation import state
from crowdbench.simulation.contact import push_through
from crowdbench.simulation.rules import AHEAD_M, command, distance_to_segment, from_own_frame, walk
from crowdbench.simulation.walls import CELL_M, cell_of
from crowdbench.spawn.recorded_plans import PASSED_M, VISIT_M

CLOSER_M = 0.5
"""Least decrease of the distance to a via point that counts as coming closer."""


@Kernel
def advance(actions, own, slots, queue, clock, constants, walls, bodies):
    """Advance every world by one step, as described in `Simulation`.

    `actions` is (W, N, 2). It is in the own frames of the people in `own` (W, N), that is, relative
    to their headings before the step, and in the world frame for all others. `bodies` are those of
    `crowdbench.simulation.contact`, or None.
    """
    radius = 0.0
    if bodies is not None:  # without bodies, their rules are not compiled
        radius = bodies.radius
    # Assigned outside of the loop: numba takes what is written to arrays of bundles for unused.
    frames, changed = clock.frame, clock.changed
    for w in prange(slots.alive.shape[0]):
        frames[w] += 1
        changed[w] = 0
        if bodies is not None:
            for i in range(slots.alive.shape[1]):
                begin_walk(w, i, actions, own, slots, constants, walls, bodies)
            push_through(w, frames[w], constants.dt, slots, bodies, walls)
        for i in range(slots.alive.shape[1]):
            move(w, i, actions, own, slots, queue, clock, constants, walls, bodies)
        let_enter(w, slots, queue, clock, constants, radius)


@subroutine
def move(w, i, actions, own, slots, queue, clock, constants, walls, bodies):
    """Move one person, and end its trip if it is over.

    Bodies have been walked already, and `bodies.at` is where the step ends.
    """
    slots.ended[w, i] = 0
    slots.spawned[w, i] = False
    if not slots.alive[w, i]:
        return
    slots.stage_before[w, i] = slots.stage[w, i]
    # np.float64, because numba's float() does not convert float32.
    x, y = np.float64(slots.position[w, i, 0]), np.float64(slots.position[w, i, 1])
    if bodies is not None:
        to_x, to_y = bodies.at[w, i, 0], bodies.at[w, i, 1]
    else:
        vx, vy = _velocity(w, i, actions, own, slots.heading, constants.max_speed)
        slots.commanded[w, i, 0], slots.commanded[w, i, 1] = vx, vy
        to_x, to_y, hit = _walk_alone(x, y, vx * constants.dt, vy * constants.dt, walls)
        slots.hit_wall[w, i] = hit
    slots.position[w, i, 0] = to_x
    slots.position[w, i, 1] = to_y
    slots.velocity[w, i, 0] = (to_x - x) / constants.dt
    slots.velocity[w, i, 1] = (to_y - y) / constants.dt
    length = math.sqrt((to_x - x) * (to_x - x) + (to_y - y) * (to_y - y))
    slots.walked[w, i] = np.float64(slots.walked[w, i]) + length
    if length < STANDING_MPS * constants.dt:
        slots.stood[w, i] += 1
    else:
        slots.heading[w, i, 0] = (to_x - x) / length
        slots.heading[w, i, 1] = (to_y - y) / length
    frame, to_goal = clock.frame[w], np.inf
    if slots.stage[w, i] != state.TO_GOAL:
        _visit(w, i, frame, x, y, to_x, to_y, slots, queue, constants)
    if slots.stage[w, i] == state.TO_GOAL:
        goal_x, goal_y = np.float64(slots.goal[w, i, 0]), np.float64(slots.goal[w, i, 1])
        to_goal = distance_to_segment(goal_x, goal_y, x, y, to_x, to_y)
    since = slots.born[w, i] + queue.wait[w, slots.event[w, i]]
    how = outcome(
        to_goal, to_x, to_y, frame, since, slots.leave[w, i], slots.scripted[w, i],
        clock.horizon[w], constants,
    )  # fmt: skip
    slots.ended[w, i] = how
    slots.alive[w, i] = how == 0
    if how != 0:
        clock.changed[w] = 1


@subroutine
def _velocity(w, i, actions, own, heading, max_speed):
    """Commanded velocity of a person in the world frame, in m/s."""
    vx, vy = command(np.float64(actions[w, i, 0]), np.float64(actions[w, i, 1]), max_speed)
    if own[w, i]:
        return from_own_frame(vx, vy, np.float64(heading[w, i, 0]), np.float64(heading[w, i, 1]))
    return vx, vy


@subroutine
def _walk_alone(x, y, dx, dy, walls):
    """Where a move ends that only walls can stop, and whether it hit one."""
    cell = cell_of(x, y, (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows))
    first, stop = walls.step_start[cell], walls.step_start[cell + 1]
    if math.sqrt(dx * dx + dy * dy) + 2 * AHEAD_M < walls.clear[cell]:
        stop = first  # no wall is within reach
    return walk(x, y, dx, dy, walls.segments, walls.step_segment, first, stop)


@subroutine
def begin_walk(w, i, actions, own, slots, constants, walls, bodies):
    """Write where a person is and what it is commanded to `bodies`, before `push_through`."""
    slots.hit_wall[w, i] = False
    slots.held[w, i] = 0.0
    if not slots.alive[w, i]:
        return
    x, y = np.float64(slots.position[w, i, 0]), np.float64(slots.position[w, i, 1])
    vx, vy = _velocity(w, i, actions, own, slots.heading, constants.max_speed)
    slots.commanded[w, i, 0], slots.commanded[w, i, 1] = vx, vy
    dx, dy = vx * constants.dt, vy * constants.dt
    if slots.scripted[w, i]:
        to_x, to_y, hit = _walk_alone(x, y, dx, dy, walls)
        slots.hit_wall[w, i] = hit
        dx, dy = to_x - x, to_y - y
    bodies.at[w, i, 0], bodies.at[w, i, 1] = x, y
    bodies.command[w, i, 0], bodies.command[w, i, 1] = dx / bodies.substeps, dy / bodies.substeps


@subroutine
def outcome(to_goal, x, y, frame, since, leave, scripted, horizon, constants):
    """Outcome of a trip that ends in this frame, by the first rule that applies; 0 if it goes on.

    `to_goal` is the distance between the goal and the path walked in this step, infinite before the
    via point has been visited. Testing only the end of the step would miss goals that fast walkers
    step over. `since` is the frame of entry plus the frames of waiting.
    """
    if not scripted:
        if to_goal <= constants.goal_radius:
            return state.GOAL
        if not (constants.x_min < x < constants.x_max and constants.y_min < y < constants.y_max):
            return state.EXIT
        if frame - since >= constants.timeout:
            return state.TIMEOUT
    if 0 <= leave <= frame:
        return state.RECORDED
    if frame >= horizon:
        return state.HORIZON
    return 0


@subroutine
def _visit(w, i, frame, x, y, to_x, to_y, slots, queue, constants):
    """Advance the visit of a person to its via point; see `Simulation` for the rules."""
    if slots.stage[w, i] == state.TO_VIA:
        e = slots.event[w, i]
        via_x, via_y = np.float64(slots.target[w, i, 0]), np.float64(slots.target[w, i, 1])
        distance = distance_to_segment(via_x, via_y, x, y, to_x, to_y)
        if distance < slots.closest[w, i] - CLOSER_M:
            slots.closest[w, i] = distance
            slots.nearer[w, i] = frame
        given_up = frame - slots.nearer[w, i] >= constants.patience_via
        passed = False
        if distance <= PASSED_M:
            way_x, way_y = via_x - queue.start[w, e, 0], via_y - queue.start[w, e, 1]
            passed = (to_x - via_x) * way_x + (to_y - via_y) * way_y > 0.0
        if distance <= VISIT_M or passed or given_up:
            slots.stage[w, i] = state.WAITING
            slots.until[w, i] = frame if given_up else frame + queue.wait[w, e]
    if slots.stage[w, i] == state.WAITING and frame >= slots.until[w, i]:
        slots.stage[w, i] = state.TO_GOAL
        slots.target[w, i, 0] = slots.goal[w, i, 0]
        slots.target[w, i, 1] = slots.goal[w, i, 1]


@subroutine
def let_enter(w, slots, queue, clock, constants, radius):
    """Let people of a world enter who are due; `radius` is that of bodies, 0 for none."""
    frame = clock.frame[w]
    if frame >= clock.horizon[w]:
        return
    free = 0  # no slot below this one is free
    e = np.int64(clock.cursor[w])  # of one type, for which all that is called is compiled once
    while e < queue.due.shape[1] and queue.due[w, e] <= frame:
        if queue.status[w, e] == state.PENDING:
            patient = queue.may_wait[w, e] and frame - queue.due[w, e] < constants.patience
            blocked = patient and _blocked(w, e, slots, queue, frame, constants.clearance)
            if radius > 0.0 and queue.may_wait[w, e] and not blocked:
                # Nobody enters into a body, be it that of somebody who enters in the same frame.
                blocked = _blocked(w, e, slots, queue, frame + 1, 2.0 * radius)
            if not blocked:
                while free < slots.alive.shape[1] and (
                    slots.alive[w, free] or slots.ended[w, free] != 0
                ):
                    free += 1
                if clock.ids[w] >= constants.max_persons:
                    clock.no_id[w] += 1
                    clock.changed[w] = 1
                    queue.status[w, e] = state.DROPPED
                elif free >= slots.alive.shape[1]:
                    clock.no_slot[w] += 1
                    clock.changed[w] = 1
                    queue.status[w, e] = state.DROPPED
                else:
                    _enter(w, free, e, slots, queue, clock)
        e += 1
    while (
        clock.cursor[w] < queue.due.shape[1]
        and queue.due[w, clock.cursor[w]] <= frame
        and queue.status[w, clock.cursor[w]] != state.PENDING
    ):
        clock.cursor[w] += 1


@subroutine
def _blocked(w, e, slots, queue, frame, clearance):
    """Whether someone who entered before a frame is too close to the start of event e.

    `clearance` is the distance that is close enough to a person, in metres.
    """
    for i in range(slots.alive.shape[1]):
        if slots.alive[w, i] and slots.born[w, i] < frame:
            dx = np.float64(slots.position[w, i, 0]) - np.float64(queue.start[w, e, 0])
            dy = np.float64(slots.position[w, i, 1]) - np.float64(queue.start[w, e, 1])
            if math.hypot(dx, dy) < clearance + np.float64(slots.wider[w, i]):
                return True
    return False


@subroutine
def _enter(w, i, e, slots, queue, clock):
    clock.changed[w] = 1
    queue.status[w, e] = state.ENTERED
    slots.alive[w, i] = True
    slots.ended[w, i] = 0
    slots.spawned[w, i] = True
    for k in range(2):
        slots.position[w, i, k] = queue.start[w, e, k]
        slots.velocity[w, i, k] = queue.velocity[w, e, k]
        slots.commanded[w, i, k] = queue.velocity[w, e, k]
        slots.goal[w, i, k] = queue.goal[w, e, k]
        slots.target[w, i, k] = queue.via[w, e, k]
    slots.stage[w, i] = state.TO_VIA
    via_x = np.float64(queue.via[w, e, 0]) - np.float64(queue.start[w, e, 0])
    via_y = np.float64(queue.via[w, e, 1]) - np.float64(queue.start[w, e, 1])
    if math.hypot(via_x, via_y) <= VISIT_M:
        slots.stage[w, i] = state.WAITING
        slots.until[w, i] = clock.frame[w] + queue.wait[w, e]
    if np.isnan(via_x) or (slots.stage[w, i] == state.WAITING and queue.wait[w, e] == 0):
        slots.stage[w, i] = state.TO_GOAL
        for k in range(2):
            slots.target[w, i, k] = queue.goal[w, e, k]
    vx, vy = np.float64(queue.velocity[w, e, 0]), np.float64(queue.velocity[w, e, 1])
    if math.sqrt(vx * vx + vy * vy) < STANDING_MPS:
        vx = np.float64(slots.target[w, i, 0]) - np.float64(slots.position[w, i, 0])
        vy = np.float64(slots.target[w, i, 1]) - np.float64(slots.position[w, i, 1])
    length = math.sqrt(vx * vx + vy * vy)
    slots.heading[w, i, 0] = vx / length if length > 0.0 else 1.0
    slots.heading[w, i, 1] = vy / length if length > 0.0 else 0.0
    slots.walked[w, i] = 0.0
    slots.stood[w, i] = 0
    slots.blocked[w, i] = 0.0
    slots.held[w, i] = 0.0
    slots.aside[w, i] = 0.0
    slots.closest[w, i] = np.inf
    slots.nearer[w, i] = clock.frame[w]
    slots.speed[w, i] = queue.speed[w, e]
    slots.person[w, i] = clock.ids[w]
    slots.event[w, i] = e
    slots.born[w, i] = clock.frame[w]
    slots.leave[w, i] = queue.leave[w, e]
    slots.scripted[w, i] = queue.scripted[w, e]
    slots.wider[w, i] = 0.0
    clock.ids[w] += 1
