"""Drawing of companions, compiled."""

import math

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.compilation import compiled

LARGEST = 10
"""Number of people in the largest groups, which is that of the largest recorded one. Without a
limit, a surge of arrivals could become a single group."""
STEP_S = 0.5
"""Step at which two ways are compared."""


@compiled(error_model="python")
def draw_joins(
    earlier: Int[np.ndarray, " n"],
    begin: Int[np.ndarray, " B"],
    weight: Float[np.ndarray, " n"],
    larger: Float[np.ndarray, " 4"],
    u: Float[np.ndarray, " E"],
) -> Int[np.ndarray, " E"]:
    """Whom each person joins, or −1.

    Person i may join `earlier[begin[i] : begin[i + 1]]`, with these weights times the factor in
    `larger` for groups of one, two, three, and four and more, unless the group is as large as it
    can be; `u` are uniform random numbers.
    """
    found = np.full(u.size, -1, np.int64)
    leader = np.arange(u.size)
    size = np.ones(u.size, np.int64)
    each = np.empty(weight.size)
    for i in range(u.size):
        total = 1.0
        for k in range(begin[i], begin[i + 1]):
            now = size[leader[earlier[k]]]
            each[k] = weight[k] * larger[min(now, larger.size) - 1] if now < LARGEST else 0.0
            total += each[k]
        aim = u[i] * total
        for k in range(begin[i], begin[i + 1]):
            aim -= each[k]
            if aim < 0:
                found[i] = earlier[k]
                leader[i] = leader[earlier[k]]
                size[leader[i]] += 1
                break
    return found


@compiled
def keep_company(
    ways: Float[np.ndarray, "n 8"],
    time_s: Float[np.ndarray, " n"],
    all_ways: Float[np.ndarray, "E 8"],
    all_time_s: Float[np.ndarray, " E"],
    others: Int[np.ndarray, "n m"],
    apart_m: float,
    within_m: float,
) -> Bool[np.ndarray, " n"]:
    """Whether people with these ways stay near the last of the others, and run into none of them.

    Ways are those of `Ways.draw`, and people walk straight to their goals.
    """
    good = np.ones(len(ways), np.bool_)
    for i in range(len(ways)):
        v, life = _moves(ways[i])
        for k in range(others.shape[1]):
            other = others[i, k]
            w, other_life = _moves(all_ways[other])
            begin = max(time_s[i], all_time_s[other])
            common = min(time_s[i] + life, all_time_s[other] + other_life) - begin
            if common < 0:  # never there together
                continue
            since, other_since = begin - time_s[i], begin - all_time_s[other]
            x = ways[i, 0] + v[0] * since - all_ways[other, 0] - w[0] * other_since
            y = ways[i, 1] + v[1] * since - all_ways[other, 1] - w[1] * other_since
            dx, dy = v[0] - w[0], v[1] - w[1]
            when = -(x * dx + y * dy) / max(dx * dx + dy * dy, 1e-12)
            when = min(max(when, 0.0), common)
            last_m = math.hypot(x + dx * common, y + dy * common)
            if math.hypot(x + dx * when, y + dy * when) < apart_m or (
                k == others.shape[1] - 1 and max(math.hypot(x, y), last_m) > within_m
            ):
                good[i] = False
                break
    return good


@compiled
def _moves(way: Float[np.ndarray, " 8"]) -> tuple[tuple[float, float], float]:
    """Velocity from start to goal, and how long it lasts, seconds."""
    x, y = way[2] - way[0], way[3] - way[1]
    length, speed = max(math.hypot(x, y), 1e-9), math.exp(way[4])
    return (x / length * speed, y / length * speed), length / speed


@compiled
def not_as_planned(
    time_s: Float[np.ndarray, " E"],
    walks: Float[np.ndarray, "E 8"],
    leader: Int[np.ndarray, " E"],
    moved: Bool[np.ndarray, " E"],
    entry_s: float,
    least_s: float,
    share: float,
    within_m: float,
    relative_mps: float,
) -> Bool[np.ndarray, " E"]:
    """Leaders of the groups in which other people walk together than planned.

    These are groups with somebody who walks with a stranger of an earlier group, or with none of
    those who came before in its own group. People enter at ascending times. `walks` are three
    points, speed and wait: people walk straight from the first point to the second one, wait there,
    and walk to the third one. The last arguments are the rule of
    `crowdbench.data.companions`. Only pairs of which one is `moved` are compared.
    """
    points, speed, wait_s = walks[:, :6], walks[:, 6], walks[:, 7]
    wrong = np.zeros(speed.size, np.bool_)
    linked = leader == np.arange(speed.size)
    first_s = np.hypot(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]) / speed
    second_s = np.hypot(points[:, 4] - points[:, 2], points[:, 5] - points[:, 3]) / speed
    leaves_s = time_s + first_s + wait_s + second_s
    for i in range(speed.size):
        for j in range(i + 1, speed.size):
            if time_s[j] - time_s[i] > entry_s:
                break
            same = leader[i] == leader[j]
            if not (moved[i] or moved[j]) or (same and linked[j]):
                continue
            end = min(leaves_s[i], leaves_s[j])
            steps = int((end - time_s[j]) / STEP_S) + 1
            if end - time_s[j] < least_s:
                continue
            far = steps - math.ceil(share * steps - 1e-9)
            near, motion = 0, 0.0
            for k in range(steps):
                t = time_s[j] + k * STEP_S
                x, y, vx, vy = _walks(points[i], first_s[i], wait_s[i], second_s[i], t - time_s[i])
                u, v, ux, uy = _walks(points[j], first_s[j], wait_s[j], second_s[j], t - time_s[j])
                if (x - u) ** 2 + (y - v) ** 2 > within_m * within_m:
                    far -= 1
                    if far < 0:
                        break
                    continue
                near += 1
                motion += math.hypot(vx - ux, vy - uy)
            if far >= 0 and motion <= relative_mps * near:
                if same:
                    linked[j] = True
                else:
                    wrong[max(leader[i], leader[j])] = True
    for j in range(speed.size):
        if moved[j] and not linked[j]:
            wrong[leader[j]] = True
    return wrong


@compiled
def _walks(
    points: Float[np.ndarray, " 6"], first_s: float, wait_s: float, second_s: float, since_s: float
) -> tuple[float, float, float, float]:
    """Where somebody is who came this long ago, and the velocity."""
    if since_s < first_s:
        a, begin, lasts = 0, 0.0, first_s
    elif since_s < first_s + wait_s or second_s == 0.0:
        return points[2], points[3], 0.0, 0.0
    else:
        a, begin, lasts = 2, first_s + wait_s, second_s
    vx, vy = (points[a + 2] - points[a]) / lasts, (points[a + 3] - points[a + 1]) / lasts
    return points[a] + vx * (since_s - begin), points[a + 1] + vy * (since_s - begin), vx, vy
