"""`RobotWorlds`: W worlds with one robot each, stepped together; the core of all environments."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy.random import SeedSequence, default_rng

from crowdbench.errors import ActionError, OwnCodeError, SettingError
from crowdbench.robot.config import PERSON_TASKS, RobotConfig, RobotReward
from crowdbench.robot.costs import Costs
from crowdbench.robot.crowds import Crowds, Poses
from crowdbench.robot.driving import drive, longest_substep_m
from crowdbench.robot.encounters import GRAZE_M, Encounter, Present, meet
from crowdbench.robot.measures import STILL_MPS, STILL_RPS, Measures, Period
from crowdbench.robot.observing import Observer
from crowdbench.robot.places import MARGIN_M, Places, routes_for
from crowdbench.robot.seeing import RobotView, find_nearest, off_walls
from crowdbench.robot.tasks import PersonTask
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation.free_space import free_space
from crowdbench.simulation.simulation import check_count
from crowdbench.simulation.walls import wall_table

_ROBOT_KEY = 2**21  # of the generators of starts, goals and noise
START_CLEARANCE_M = 1.0
"""No person is nearer than this to the surface of a robot at its start, if possible."""


class Step(NamedTuple):
    """What a control period brought to each world."""

    reward: Float32[np.ndarray, " W"]
    terminated: Bool[np.ndarray, " W"]
    """The last goal was reached, or the robot collided and that ends an episode."""
    truncated: Bool[np.ndarray, " W"]
    """The time limit was reached."""


class RobotWorlds:
    """W worlds of a scene, in each of which a robot drives among people who come and go.

    The people of a world go on walking when its robot begins a new episode. A world's arrivals,
    starts, goals and noise depend on its own seed only: a world with seed s gives the same episodes
    alone as beside others, if its robot acts in the same way.
    """

    def __init__(
        self,
        scene: str | Path | Scene,
        worlds: int = 1,
        config: RobotConfig | None = None,
        **settings: Any,
    ) -> None:
        """Create the worlds; `begin` begins their first episodes.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            worlds: their number W.
            config: the settings, by default those of `RobotConfig()`.
            settings: fields of `RobotConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model, file or
                recording does not exist or does not fit.
        """
        check_count("worlds", worlds)
        self.config = config = RobotConfig.of(config, **settings)
        self.scene, self.worlds = load_scene(scene), worlds
        self.crowds = Crowds(self.scene, worlds, config)
        self.robot = robot = self.crowds.robot
        self.periods = _periods(self.scene.dt_s, config.period_s)
        self.period_s = self.scene.dt_s / self.periods
        self.limit = int(np.ceil(config.time_limit_s / self.period_s - 1e-6))
        self.places = Places(self.scene, robot.radius_m, config)
        self._routes = routes_for(self.scene, robot.radius_m)
        b = self.scene.bounds
        self._bounds = (b.x_min_m, b.x_max_m, b.y_min_m, b.y_max_m)
        self._walls = wall_table(
            self.scene.wall_segments.tobytes(),
            lower=(b.x_min_m, b.y_min_m),
            upper=(b.x_max_m, b.y_max_m),
            rays=0,
            ray_range_m=config.range_m,
            step_m=robot.radius_m + longest_substep_m(robot.limits),
        )
        slides = self.scene.motion.body_radius_m > 0 and not self.crowds.replayed
        self._graze_m = GRAZE_M if slides else 0.0
        self._free = free_space(self.scene.walls, b)
        self.view = RobotView.empty(self.scene, robot, self.period_s, worlds, config.nearest)
        self.present = Present.nobody(worlds, self.crowds.people)
        self.encounter = Encounter.none(worlds)
        self.measures = Measures(worlds, self.period_s)
        self._costs = Costs(self.crowds) if config.costs else None
        self._observer = Observer(config, self.view, self.scene.wall_segments)
        self.observation_space = self._observer.space
        self.goals = np.zeros((worlds, config.goals, 2))
        """(W, goals, 2) the goals of each episode, metres."""
        self.start = np.zeros((worlds, 2))
        """(W, 2) where each robot started, metres."""
        self.reached = np.zeros(worlds, np.int64)
        """(W,) number of goals reached in the present episode."""
        self.progress_m = np.zeros(worlds)
        """(W,) decrease of the path length to the goal in the last period, metres."""
        self.hit_wall = np.zeros(worlds, bool)
        """(W,) whether the robot met a wall in the last period."""
        self.contacts = np.zeros(worlds, np.int64)
        """(W,) contacts with people or walls that began in the last period."""
        self.success = np.zeros(worlds, bool)
        """(W,) whether the last goal has been reached in the present episode."""
        self.over = np.zeros(worlds, bool)
        """(W,) whether the person whom the task is about is gone or has come past."""
        self.person = PersonTask(self) if config.task in PERSON_TASKS else None
        """The persons whom the episodes are about, if the task is about one."""
        self._all, self._nowhere = np.arange(worlds), np.zeros(worlds, bool)
        self._rngs = [default_rng(0)] * worlds
        self._keys = np.zeros(worlds, np.uint64)
        self._tick = 0
        self._before = np.zeros((worlds, 2))
        self._actions = np.zeros((worlds, 2))
        self._begun = False

    def begin(
        self, seeds: Int[np.ndarray, " n"], worlds: Int[np.ndarray, " n"] | None = None
    ) -> None:
        """Begin episodes with new crowds in some worlds, by default all, one seed for each.

        All worlds must have begun before some of them begin anew.
        """
        worlds = self._all if worlds is None else worlds
        if len(worlds) == self.worlds:
            self._tick = 0
        seeds = np.asarray(seeds, np.int64)
        for world, seed in zip(worlds.tolist(), seeds.tolist(), strict=True):
            self._rngs[world] = default_rng(SeedSequence(seed, spawn_key=(_ROBOT_KEY,)))
        self.crowds.begin(worlds, seeds)
        self._begun = True
        self._start(worlds)

    def go_on(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Begin new episodes in some worlds, among the people who are there.

        Where too little time of a crowd is left for an episode, a new one takes its place.
        """
        self.crowds.renew(worlds)
        self._start(worlds)

    def _start(self, worlds: Int[np.ndarray, " n"]) -> None:
        view, config = self.view, self.config
        self._meet(worlds, self._share, self._share)  # where people are now
        clearance_m = self.crowds.reach_m + START_CLEARANCE_M
        for w in worlds.tolist():
            rng = self._rngs[w]
            there = self.present.position[w][self.present.there[w]]
            if self.person is None:
                self.start[w], self.goals[w] = self.places.draw(rng, there, clearance_m)
            else:
                self.start[w], self.goals[w] = self.person.begin(w, clearance_m)
            self._keys[w] = rng.integers(2**63)
        view.position[worlds] = self._before[worlds] = self.start[worlds]
        view.goal[worlds] = self.goals[worlds, 0]
        view.velocity[worlds] = view.speed[worlds] = view.turn[worlds] = 0.0
        self.reached[worlds] = 0
        for of in (self.success, self.over, self.hit_wall, self.contacts, self.progress_m):
            of[worlds] = 0
        self._find_way(worlds)
        way = view.towards[worlds] - view.position[worlds]
        view.heading[worlds] = np.arctan2(way[:, 1], way[:, 0])
        shortest = view.remaining[worlds].copy()
        for k in range(1, config.goals):
            leg = np.full(len(worlds), k)
            to, beyond = self._routes.next_of(
                worlds, leg, self.goals[worlds, k - 1], self.goals[worlds, k]
            )
            shortest += np.linalg.norm(to - self.goals[worlds, k - 1], axis=1) + beyond
        self.measures.begin(worlds, shortest)
        if self._costs is not None:
            self._costs.begin(worlds)
        self.crowds.place(worlds, Poses(view.position, view.heading, view.velocity, view.goal))
        self._meet(worlds, self._share, self._share)
        self._find_people(worlds)

    @property
    def _share(self) -> float:
        """The share of the present frame that has passed; 1 at its end."""
        return self._tick / self.periods if self._tick else 1.0

    def step(self, actions: np.ndarray) -> Step:
        """Drive all robots for a control period by actions (W, 2).

        Raises:
            ActionError: no episode has begun, or actions have another shape or are not finite.
            OwnCodeError: a reward of one's own fails, or returns something else than W finite
                numbers.
        """
        given = np.asarray(actions)
        if not self._begun:
            raise ActionError("step", got="no episode", expected="a call of reset first")
        if given.shape != (self.worlds, 2) or given.dtype.kind not in "fiu":
            raise ActionError(
                "step",
                got=f"an array of shape {given.shape} and type {given.dtype}",
                expected=f"one action for each robot, numbers of shape ({self.worlds}, 2)",
            )
        if not np.isfinite(given).all():
            raise ActionError(
                "step",
                got=f"{int((~np.isfinite(given)).sum())} values that are not finite",
                expected="finite numbers",
                hint="Check the controller for a division by zero or a diverged network.",
            )
        np.clip(given, -1.0, 1.0, out=self._actions)
        view = self.view
        if self._tick == 0:
            self.crowds.advance()
            if self._costs is not None:
                self._costs.add()
        since, until = self._tick / self.periods, (self._tick + 1) / self.periods
        np.copyto(self._before, view.position)
        pressed = self.hit_wall.copy()
        drive(
            self._actions, self.period_s, self.robot.limits, self._bounds, self._walls,
            view.position, view.heading, view.velocity, view.speed, view.turn, self.hit_wall,
        )  # fmt: skip
        self._meet(self._all, since, until)
        if self.person is not None:
            self.person.update()
        before_m = view.remaining.copy()
        self._find_way(self._all)
        self.progress_m = before_m - view.remaining
        began = self.hit_wall & ~pressed
        self.contacts = self.encounter.contacts + began
        ends = self.contacts > 0 if self.config.collision == "terminate" else self._nowhere
        if self.person is None:
            self._reach_goals(ends)
        else:
            self.over = self.person.over
            self.success |= self.person.reached & ~ends
        self._find_people(self._all)
        moved = view.position - self._before
        still = np.abs(view.speed) < STILL_MPS
        if self.robot.kinematics == "unicycle":
            still &= np.abs(view.turn) < STILL_RPS
        self.measures.add(
            Period(
                moved_m=np.sqrt((moved * moved).sum(axis=1)),
                velocity=view.velocity,
                still=still,
                gap_m=self.encounter.gap,
                collision_s=self.encounter.collision_s,
                contacts=self.encounter.contacts,
                walls=began,
            )
        )
        self._tick = (self._tick + 1) % self.periods
        if self._tick == 0:
            self.crowds.show(Poses(view.position, view.heading, view.velocity, view.goal))
        terminated = self.success | self.over | ends
        truncated = (self.measures.steps >= self.limit) & ~terminated
        return Step(self._reward(), terminated, truncated)

    def observe(self, worlds: Int[np.ndarray, " n"] | None = None) -> Any:
        """Observations of all robots, (W, size) or a dictionary of arrays, as new arrays.

        They are computed anew in `worlds`, by default all.
        """
        worlds = self._all if worlds is None else worlds
        return self._observer.observe(worlds, self.present, self._keys, self.measures.steps)

    def results(self, worlds: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
        """The measures and costs of the episodes of some worlds so far, each (n,)."""
        late = self.measures.steps[worlds] >= self.limit
        success = self.success[worlds]
        ends = self.config.collision == "terminate"
        timeout = late & ~success & ~self.over[worlds]
        timeout &= ~(self.measures.collided[worlds] & ends)
        found = self.measures.of(worlds, success, timeout)
        if self.person is not None and self.config.task == "follow":
            del found["spl"]  # how long the way is depends on the person
            found |= self.person.measures(worlds)
        return found if self._costs is None else found | self._costs.of(worlds)

    def _meet(self, worlds: Int[np.ndarray, " n"], since: float, until: float) -> None:
        crowds, slots = self.crowds, self.crowds.simulation.slots
        meet(
            worlds, since, until, crowds.before, crowds.was_there, slots.alive, slots.position,
            slots.velocity, self._before, self.view.position, self.view.velocity, crowds.reach_m,
            self._graze_m, self.present, self.encounter,
        )  # fmt: skip

    def _find_way(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Write the next point of the paths, and their lengths, to the view."""
        view = self.view
        position = view.position[worlds]
        off_walls(position, self.robot.radius_m + MARGIN_M, self._free)
        leg = self.reached[worlds] % self.config.goals
        towards, beyond = self._routes.next_of(worlds, leg, position, view.goal[worlds])
        way = towards - view.position[worlds]
        view.towards[worlds] = towards
        view.remaining[worlds] = np.sqrt((way * way).sum(axis=1)) + beyond
        if self.person is not None:
            self.person.aim(worlds)

    def _find_people(self, worlds: Int[np.ndarray, " n"]) -> None:
        view = self.view
        find_nearest(
            worlds, view.position, self.present, self.config.range_m, self.crowds.person_radius_m,
            view.near, view.near_velocity, view.near_radius, view.there,
        )  # fmt: skip

    def _reach_goals(self, ends: Bool[np.ndarray, " W"]) -> None:
        """Count the goals that robots passed in the period, and turn to the next ones.

        Where a contact `ends` the episode in the same period, no goal is reached.
        """
        view = self.view
        off = _distance_to_way(view.goal, self._before, view.position)
        at = np.flatnonzero((off <= self.config.goal_radius_m) & ~self.success & ~ends)
        if not len(at):
            return
        self.reached[at] += 1
        last = self.reached[at] >= self.config.goals
        self.success[at[last]] = True
        onward = at[~last]
        view.goal[onward] = self.goals[onward, self.reached[onward]]
        self._find_way(onward)

    def _reward(self) -> Float32[np.ndarray, " W"]:
        weights = self.config.reward
        if isinstance(weights, RobotReward):
            near = np.maximum(0.0, 1.0 - np.maximum(self.encounter.gap, 0.0) / weights.discomfort_m)
            reward = (
                weights.progress * self.progress_m
                + weights.success * self.success
                - weights.collision * self.contacts
                - self.period_s * (weights.discomfort * near + weights.time)
            )
            return reward.astype(np.float32)
        try:
            own = np.asarray(weights(self), np.float32)
        except Exception as error:
            raise OwnCodeError(
                "reward", got=f"{type(error).__name__}: {error}", expected="one number per world"
            ) from error
        if own.shape != (self.worlds,) or not np.isfinite(own).all():
            raise OwnCodeError(
                "reward",
                got=f"an array of shape {own.shape}"
                if own.shape != (self.worlds,)
                else "values that are not finite",
                expected=f"finite numbers of shape ({self.worlds},)",
            )
        return own


def _periods(dt_s: float, period_s: float | None) -> int:
    """Number of control periods in a frame."""
    if period_s is None:
        return 1
    holds = isinstance(period_s, int | float) and 0 < period_s <= dt_s * (1 + 1e-6)
    periods = round(dt_s / period_s) if holds else 0
    if periods < 1 or abs(periods * period_s - dt_s) > 1e-3 * dt_s:
        raise SettingError(
            "period_s",
            got=repr(period_s),
            expected=f"the scene's frame of {dt_s:g} s divided by a whole number",
        )
    return periods


def _distance_to_way(
    point: Float[np.ndarray, "W 2"], start: Float[np.ndarray, "W 2"], end: Float[np.ndarray, "W 2"]
) -> Float[np.ndarray, " W"]:
    """Distance of points from the straight ways between two others, metres."""
    way, off = end - start, point - start
    squared = (way * way).sum(axis=1)
    share = np.clip((off * way).sum(axis=1) / np.maximum(squared, 1e-12), 0.0, 1.0)
    apart = off - share[:, None] * way
    return np.sqrt((apart * apart).sum(axis=1))
