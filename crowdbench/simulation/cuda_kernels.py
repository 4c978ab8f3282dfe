"""CUDA kernels of the simulation: threads around the functions that the kernels of the CPU call.

A block of threads moves one world, because people of a world meet. What a person sees and is paid
is computed by a thread of its own. Memory that the CPU's kernels allocate is local to a thread
here; its size is part of the compiled code, so `kernels` compiles them for a number of corners.
Everything is done in the order of the CPU, so the results are the same, but for products and sums
that a device rounds only once (fused multiply-add).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from crowdbench.compilation import subroutine
from crowdbench.simulation import contact, observations, reward, routes, social, step

PLANE = (contact.PLANES, 3)
NEAREST = social.NEAREST
_HERE, _GONE, _NEW = 1, 2, 3  # present, ended in this step, entered in this step


class Kernels(NamedTuple):
    """The kernels for a scene; each is launched as `kernel[blocks, threads, stream](…)`."""

    advance: Any
    """One block per world of people without bodies; see `crowdbench.simulation.step.advance`."""
    advance_bodies: Any
    """The same for people with bodies."""
    route: Any
    """One thread per slot; see `crowdbench.simulation.routes`."""
    observe: Any
    """One thread per slot; see `crowdbench.simulation.observations.observe`."""
    observe_social: Any
    """One thread per slot; see `crowdbench.simulation.social.observe_social`."""
    pay: Any
    """One thread per slot; see `crowdbench.simulation.reward.pay`."""


@subroutine
def begin_step(w, first, clock):
    """The first thread of a block advances the clock of its world."""
    if first == 0:
        clock.frame[w] += 1
        clock.changed[w] = 0


@subroutine
def visibility(w, i, slots):
    """How a slot is seen: 0 if it is empty, else `_HERE`, `_GONE` or `_NEW`."""
    if slots.ended[w, i] != 0:
        return _GONE
    if slots.alive[w, i]:
        return _NEW if slots.spawned[w, i] else _HERE
    return 0


@subroutine
def sees(mine, other):
    """Whether somebody sees somebody else; as `crowdbench.simulation.cells.neighbours`."""
    if mine == _GONE:
        return other in (_HERE, _GONE)
    return other in (_HERE, _NEW)


@subroutine
def widest_in(w, slots):
    """The largest `wider` of those present and just ended in a world, in metres."""
    widest = 0.0
    for j in range(slots.alive.shape[1]):
        if slots.alive[w, j] or slots.ended[w, j] != 0:
            widest = max(widest, np.float64(slots.wider[w, j]))
    return widest


@subroutine
def apart_of(w, i, slots, group):
    """Distance to the nearest companion; as `crowdbench.simulation.reward.measure_companions`."""
    mine = group[w, slots.event[w, i]]
    least = np.float32(np.inf)
    if mine >= 0:
        for j in range(slots.alive.shape[1]):
            there = slots.alive[w, j] or slots.ended[w, j] != 0
            if j != i and there and group[w, slots.event[w, j]] == mine:
                dx = slots.position[w, i, 0] - slots.position[w, j, 0]
                dy = slots.position[w, i, 1] - slots.position[w, j, 1]
                least = min(least, np.float32(math.sqrt(dx * dx + dy * dy)))
    return least if least < np.float32(np.inf) else np.float32(0.0)


@subroutine
def precedes(w, j, i, at):
    """−1 or 1 if slot j is before or after slot i by x, then y; 0 if both are at the same place."""
    if at[w, j, 0] != at[w, i, 0]:
        return -1 if at[w, j, 0] < at[w, i, 0] else 1
    if at[w, j, 1] != at[w, i, 1]:
        return -1 if at[w, j, 1] < at[w, i, 1] else 1
    return 0


@subroutine
def rank_of(w, k, count, at, order):
    """Place of the k-th of `count` people in `order` when they are sorted by x, then y."""
    i, rank = order[w, k], 0
    for m in range(count):
        before = precedes(w, order[w, m], i, at)
        if m != k and (before < 0 or (before == 0 and m < k)):
            rank += 1
    return rank


@subroutine
def is_busy(w, k, count, part, step_s, slots, bodies, walls):
    """Whether the k-th by x can meet somebody or a wall in this step.

    As in `crowdbench.simulation.contact`, with the same sums, so that the answers are the same.
    """
    at, order, wider = bodies.at, bodies.order, slots.wider
    i, two, share = order[w, k], 2.0 * bodies.radius, step_s / contact.HEADWAY_S
    mine = bodies.moved[w, i, 0] + part
    if slots.blocked[w, i] > 0.0 or slots.aside[w, i] > 0.0:
        return True
    if contact.near_wall(at[w, i, 0], at[w, i, 1], mine, bodies, walls):
        return True
    for m in range(count):
        if m != k:
            j = order[w, m]
            ex, ey = at[w, j, 0] - at[w, i, 0], at[w, j, 1] - at[w, i, 1]
            first, second = (i, j) if k < m else (j, i)
            touch = two + np.float64(wider[w, first]) + np.float64(wider[w, second])
            theirs = bodies.moved[w, j, 0] + part
            reach = contact.reach_of(mine, theirs, touch, share, bodies.substeps)
            if ex * ex + ey * ey < reach * reach:
                return True
    return False


@subroutine
def overlaps(w, k, count, slots, bodies):
    """Whether the k-th by x overlaps with somebody after it."""
    at, order, wider = bodies.at, bodies.order, slots.wider
    i = order[w, k]
    mine = 2.0 * bodies.radius + np.float64(wider[w, i])
    for m in range(k + 1, count):
        j = order[w, m]
        ex, ey = at[w, j, 0] - at[w, i, 0], at[w, j, 1] - at[w, i, 1]
        touch = mine + np.float64(wider[w, j])
        if ex * ex + ey * ey < touch * touch:
            return True
    return False


@cuda.jit(device=True)
def sort(w, first, threads, count, at, order, spare):
    """Sort `order` by x, then y, by all threads of a block; `spare` is working memory."""
    for k in range(first, count, threads):
        spare[w, rank_of(w, k, count, at, order)] = order[w, k]
    cuda.syncthreads()
    for k in range(first, count, threads):
        order[w, k] = spare[w, k]
    cuda.syncthreads()


@cuda.jit(device=True)
def walk_together(w, frame, dt, slots, bodies, walls, spare):
    """Walk the bodies of a world, by all threads of a block; as `contact.push_through`."""
    first, threads, size = cuda.threadIdx.x, cuda.blockDim.x, slots.alive.shape[1]
    at, command, order, busy = bodies.at, bodies.command, bodies.order, bodies.met
    plane = cuda.local.array(PLANE, np.float64)
    overlap = cuda.shared.array(1, np.int32)
    step_s = dt / bodies.substeps
    if first == 0:
        overlap[0] = 0
    # Everyone present, by x. The CPU sorts a list by slots, so slots decide between equals.
    count, widest, recorded = 0, 0.0, False
    for i in range(size):
        if slots.alive[w, i]:
            if i % threads == first:
                dx, dy = command[w, i, 0], command[w, i, 1]
                bodies.moved[w, i, 0] = math.sqrt(dx * dx + dy * dy)
                spare[w, count] = i
            count += 1
            widest = max(widest, np.float64(slots.wider[w, i]))
            recorded = recorded or (slots.scripted[w, i] and slots.leave[w, i] >= 0)
    cuda.syncthreads()
    for k in range(first, count, threads):
        order[w, k] = spare[w, k]
    cuda.syncthreads()
    sort(w, first, threads, count, at, order, spare)
    for k in range(first, count, threads):
        if overlaps(w, k, count, slots, bodies):
            overlap[0] = 1
    cuda.syncthreads()
    part = contact.PART_MPS * step_s if recorded or overlap[0] == 1 else 0.0
    for k in range(first, count, threads):
        busy[w, order[w, k]] = is_busy(w, k, count, part, step_s, slots, bodies, walls)
    cuda.syncthreads()
    # Who meets nobody walks at once; the others are listed.
    others = 0
    for k in range(count):
        i = order[w, k]
        if busy[w, i]:
            if k % threads == first:
                spare[w, others] = i
            others += 1
        elif k % threads == first:
            at[w, i, 0] += bodies.substeps * command[w, i, 0]
            at[w, i, 1] += bodies.substeps * command[w, i, 1]
    cuda.syncthreads()
    for k in range(first, others, threads):
        order[w, k] = spare[w, k]
    cuda.syncthreads()
    for sub in range(bodies.substeps):
        tick = frame * bodies.substeps + sub
        for k in range(first, others, threads):
            contact.walk_script(w, order[w, k], slots, bodies)
        cuda.syncthreads()
        sort(w, first, threads, others, at, order, spare)
        for k in range(first, others, threads):
            contact.choose_way(w, k, others, tick, step_s, part, widest, slots, bodies, walls,
                               plane)  # fmt: skip
        cuda.syncthreads()
        for k in range(first, others, threads):
            contact.go(w, order[w, k], step_s, slots, bodies)
        cuda.syncthreads()


def kernels(corners: int) -> Kernels:
    """The kernels for a scene with so many corners; they are compiled when they are launched."""
    room = max(1, corners)

    @cuda.jit
    def advance(actions, own, slots, queue, clock, constants, walls, remaining, before):
        w, first, threads = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
        begin_step(w, first, clock)
        cuda.syncthreads()
        for i in range(first, slots.alive.shape[1], threads):
            before[w, i] = remaining[w, i]
            step.move(w, i, actions, own, slots, queue, clock, constants, walls, None)
        cuda.syncthreads()
        if first == 0:
            step.let_enter(w, slots, queue, clock, constants, 0.0)

    @cuda.jit
    def advance_bodies(actions, own, slots, queue, clock, constants, walls, remaining, before,
                       bodies, spare):  # fmt: skip
        w, first, threads = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
        begin_step(w, first, clock)
        for i in range(first, slots.alive.shape[1], threads):
            step.begin_walk(w, i, actions, own, slots, constants, walls, bodies)
        cuda.syncthreads()
        walk_together(w, clock.frame[w], constants.dt, slots, bodies, walls, spare)
        for i in range(first, slots.alive.shape[1], threads):
            before[w, i] = remaining[w, i]
            step.move(w, i, actions, own, slots, queue, clock, constants, walls, bodies)
        cuda.syncthreads()
        if first == 0:
            step.let_enter(w, slots, queue, clock, constants, bodies.radius)

    @cuda.jit
    def route(slots, towards, beyond, known, of, seen, to_goal, corners, corner_x, corner_y,
              between, sight):  # fmt: skip
        size = slots.alive.shape[1]
        a = cuda.grid(1)
        w, i = a // size, a % size
        if w < slots.alive.shape[0] and (slots.alive[w, i] or slots.ended[w, i] != 0):
            at = cuda.local.array(2, np.float64)
            goal = cuda.local.array(2, np.float64)
            ways = cuda.local.array(room, np.float64)
            tried = cuda.local.array(room, np.int64)
            spare = cuda.local.array(5, np.float64)
            rest = cuda.local.array(1, np.float64)
            for k in range(2):
                at[k] = np.float64(slots.position[w, i, k])
                goal[k] = np.float64(slots.target[w, i, k])
            rest[0] = 0.0
            if len(sight.segments) > 0:
                routes.next_of(
                    w, i, at, goal, rest, 0, known, of, seen, to_goal, corners, corner_x, corner_y,
                    between, sight, ways, tried, spare,
                )  # fmt: skip
            towards[w, i, 0], towards[w, i, 1], beyond[w, i] = goal[0], goal[1], rest[0]

    @cuda.jit
    def observe(slots, towards, beyond, head, cos, sin, walls, constants, radius, reach, remaining,
                nearest, out):  # fmt: skip
        size = slots.alive.shape[1]
        a = cuda.grid(1)
        w, i = a // size, a % size
        mine = visibility(w, i, slots) if w < slots.alive.shape[0] else 0
        if mine != 0:
            me = out[w, i]
            remaining[w, i] = observations.see_itself(
                w, i, slots, towards, beyond, head, reach, constants, me
            )
            x, y = np.float64(slots.position[w, i, 0]), np.float64(slots.position[w, i, 1])
            rays = me[head:]
            observations.see_walls(x, y, walls, reach, rays)
            far = reach + radius + widest_in(w, slots)
            squared = np.float32(np.inf)
            for j in range(size):
                if j != i and sees(mine, visibility(w, j, slots)):
                    dx = np.float64(slots.position[w, j, 0]) - x
                    dy = np.float64(slots.position[w, j, 1]) - y
                    if dx * dx + dy * dy < far * far:
                        gap = observations.see_person(
                            np.float32(dx), np.float32(dy), np.float64(slots.wider[w, j]), radius,
                            cos, sin, rays,
                        )  # fmt: skip
                        squared = min(squared, gap)
            nearest[w, i] = math.sqrt(squared)
            for k in range(len(rays)):
                rays[k] /= np.float32(reach)

    @cuda.jit
    def observe_social(slots, queue, clock, towards, beyond, free, constants, remaining, nearest,
                       out):  # fmt: skip
        size = slots.alive.shape[1]
        a = cuda.grid(1)
        w, i = a // size, a % size
        mine = visibility(w, i, slots) if w < slots.alive.shape[0] else 0
        if mine != 0:
            me = out[w, i]
            best = cuda.local.array(NEAREST, np.int32)
            gaps = cuda.local.array(NEAREST, np.float32)
            remaining[w, i] = social.see_itself(
                w, i, slots, queue, clock, towards, beyond, constants, me
            )
            x, y = np.float64(slots.position[w, i, 0]), np.float64(slots.position[w, i, 1])
            cos, sin = np.float64(slots.heading[w, i, 0]), np.float64(slots.heading[w, i, 1])
            grid = (free.x_min, free.y_min, free.per_x, free.per_y, free.columns, free.rows)
            social.probe(x, y, cos, sin, free.distance, grid, me)
            far, count = social.RANGE_M + widest_in(w, slots), 0
            for j in range(size):
                if j != i and sees(mine, visibility(w, j, slots)):
                    dx = np.float64(slots.position[w, j, 0]) - x
                    dy = np.float64(slots.position[w, j, 1]) - y
                    if dx * dx + dy * dy < far * far:
                        fx, fy, gap = np.float32(dx), np.float32(dy), 0.0
                        if far > social.RANGE_M:
                            fx, fy, gap = social.drawn_nearer(fx, fy, slots.wider[w, j])
                        if gap < social.RANGE_M:
                            count = social.consider(fx * fx + fy * fy, j, count, best, gaps)
            nearest[w, i] = math.sqrt(gaps[0]) if count > 0 else np.inf
            social.see_nearest(w, i, count, best, slots, queue, constants, me)

    @cuda.jit
    def pay(slots, queue, towards, remaining, before, nearest, dt, goal_radius, diameter,
            body_radius, weights, person, behind, out):  # fmt: skip
        size = slots.alive.shape[1]
        a = cuda.grid(1)
        w, i = a // size, a % size
        if w < slots.alive.shape[0]:
            for k in range(out.shape[2]):
                out[w, i, k] = 0.0
            reward.pay_person(
                w, i, slots, queue, towards, remaining, before, nearest, dt, goal_radius, diameter,
                body_radius, weights, person, behind, apart_of(w, i, slots, queue.group), out,
            )  # fmt: skip

    return Kernels(advance, advance_bodies, route, observe, observe_social, pay)
