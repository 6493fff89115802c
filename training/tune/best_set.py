"""Search for the best parameter set of a robot in a given time.

The stages are CMA-ES in two simulators, a last race, and pruning.

The command (__main__.py) runs the search. Its algorithms are in search.py.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.drives.end_rules import TIME_LIMIT
from applr_ros1.planner.parameters import obstacle_range
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy import methods
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.parameter_space import ParameterSet, Space, space_of
from applr_ros1.robots import NAMES, Robot, load
from training.attempts.candidates import search_space
from training.env.settings import CHALLENGE, TrialSettings
from training.evaluate.drive import drive
from training.evaluate.runner import TrialWorld, run
from training.evaluate.score import AIMS, Baseline
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, Trial
from training.robot.open_floor import show
from training.train.learner.config import recipe
from training.tune.clock import SearchClock
from training.tune.options import TuneOptions
from training.tune.search import (
    Block,
    Effect,
    Evaluate,
    blocks_of,
    plan_sets,
    prune_parameters,
    race,
    search,
)
from training.workers.pool import Pool

# Ends of the stages as shares of the time of the search. The kinematic simulator takes less time
# for a drive, so that the search begins in it.
COARSE_SHARE = 0.29  # search in the kinematic simulator
SEARCH_SHARE = 0.72  # search in pybullet
RACE_SHARE = 0.86  # race of the best parameter sets
PRUNE_SHARE = 1.0  # pruning
# Arguments of search(), which explains them.
SEARCH: Dict[str, Any] = {
    "sigma": 0.3,
    "population": 12,
    "worlds_per_set": 20,
}
COARSE = "kinematic"  # simulator of the first part of the search
FINE = "pybullet"  # simulator of everything after it
# time limit of a drive of the search, in optimal times of the longest course
LIMIT_OPTIMAL_TIMES = 10.0
# number of generations whose means enter the last race; their winners are often only lucky
FINALISTS = 5
PRUNE_BLOCKS = 6  # largest number of blocks of trials that decide on reverting a parameter
LINES_S = 10.0, 15.0  # time until the first progress line, and interval between further lines [s]
DIGITS = 4  # significant digits of the values of a set
# Randomisation of the drives, with the values of the recipe jackal: all but that of the ground
DRAWN = ("start_xy", "start_yaw", "scan_noise", "latency", "friction", "slip", "odometry")


def drives_of(robot: Robot, worlds: Sequence[TrialWorld]) -> TrialSettings:
    """Return the trial settings of a search in these worlds; best_set() adds the simulator."""
    longest_m = max(listed.world.course.route_m for listed in worlds)
    optimal_s = longest_m / robot.base.max_speed
    rules: Dict[str, Any] = {"protocol": CHALLENGE, "planner": CPP_LIKE}
    of_recipe = recipe("jackal")
    return TrialSettings(
        **rules,
        robot=robot,
        loaded=True,
        randomisation={name: of_recipe[name] for name in DRAWN},
        time_limit=min(TIME_LIMIT, LIMIT_OPTIMAL_TIMES * optimal_s),
    )


class Driver:
    """Drives parameter sets in the worlds of a search, each trial once.

    Args:
        settings: Trial settings from drives_of().
        worlds: [(name, specification), ...].
        pool: Workers that drive.
        table: Table that keeps the trials.
    """

    def __init__(
        self,
        settings: TrialSettings,
        worlds: Sequence[Tuple[str, str]],
        pool: Pool,
        table: TrialTable,
    ):
        self._settings = settings
        self._worlds = worlds
        self._pool = pool
        self._table = table
        self._space = search_space(settings.robot)

    def evaluate(
        self, simulator: str, sets: np.ndarray, block: Block, seed: int
    ) -> List[List[Result]]:
        """Return the results of each of `sets` (k, n) in the worlds of a block."""
        settings = self._settings.model_copy(update={"simulator": simulator})
        whole_sets = np.array([self._space.fill(theta) for theta in sets])
        plan = plan_sets(self._space, self._worlds, whole_sets, block, seed, simulator)
        # All sets drive one world before the next.
        plan = [list(map(self._started, trials_of_set)) for trials_of_set in plan]
        trials: List[Trial] = []
        for trials_in_world in zip(*plan):
            trials += trials_in_world
        message = f"driving {len(trials)} courses in {simulator} ({len(block)} with each set)"
        with announced(message, show, *LINES_S):
            results = drive(self._pool, partial(run, settings), self._table, trials)
        results_of_sets = []
        for trials_of_set in plan:
            results_of_sets.append([results[trial] for trial in trials_of_set])
        return results_of_sets

    def _started(self, trial: Trial) -> Trial:
        """Return a trial of a set of the search, whose obstacle range is no live parameter."""
        if obstacle_range.NAME not in self._space.names or trial.theta is None:
            return trial
        *theta, searched_range = trial.theta
        needed_range: Optional[float] = searched_range
        # The files may clear farther than `seeing` does.
        if searched_range == self._space.theta0[-1]:
            needed_range = None
        return replace(trial, theta=tuple(theta), obstacle_range=needed_range)


def best_set(
    options: TuneOptions,
    settings: TrialSettings,
    worlds: Sequence[TrialWorld],
    first: np.ndarray,
    table: TrialTable,
    clock: SearchClock,
) -> Tuple[np.ndarray, Dict[str, Effect]]:
    """Return the best set (n,) of search_space(), and the effect of each changed parameter.

    Args:
        options: Options of the command.
        settings: Trial settings from drives_of().
        worlds: Worlds of the search, from world_list().
        first: Parameter sets (k, n) of search_space() with which the search begins, from
            warm_starts().
        table: Table that keeps the trials.
        clock: Clock that ends each stage.

    Raises:
        ApplrError: No set arrives on any course.
    """
    robot = settings.robot
    seed = options.seed
    whole = search_space(robot)
    space = whole.chosen
    names = [(listed.name, listed.specification) for listed in worlds]
    blocks = blocks_of(len(worlds), seed)
    simulators: List[str] = []  # simulator of each generation
    means: List[Array] = []  # mean of the distribution after each generation

    def report(line: str) -> None:
        show(f"{options.minutes * clock.spent():4.1f} min: {line}")

    with Pool(options.workers) as pool:
        driver = Driver(settings, names, pool, table)
        coarse = partial(driver.evaluate, COARSE)
        fine = partial(driver.evaluate, FINE)

        def rounds() -> Iterator[Evaluate]:
            """Yield the function that drives each generation until the end of the search."""
            share_spent = clock.spent()
            while share_spent < SEARCH_SHARE or not simulators:
                simulators.append(COARSE if share_spent < COARSE_SHARE else FINE)
                yield partial(driver.evaluate, simulators[-1])
                share_spent = clock.spent()

        # Costs of pace, jerk and turning are relative to the drives with the default parameters.
        first_worlds = sum(blocks[:2], [])
        (results,) = coarse(space.theta0[None], first_worlds, seed)
        baseline = Baseline.of(results, robot)
        cost = partial(AIMS[options.for_].cost, robot=robot, baseline=baseline)

        # The starting sets race. The search begins around the best one.
        started = race(partial(coarse, seed=seed), whole.chosen_of(first), blocks[:2], cost)
        report(f"best of {len(started)} starting sets: {started[0]}")
        starts = [raced.theta for raced in started]
        for winner, mean in search(space, len(names), rounds(), starts, cost, seed=seed, **SEARCH):
            means.append(mean)
            report(f"generation {len(means)}, {simulators[-1]}: {winner}")

        # Defaults, starting sets and the means of the last generations race in the fine simulator.
        finalists = [space.theta0, *map(space.clip, starts), *means[-FINALISTS:]]
        distinct = np.array(list(dict.fromkeys(map(tuple, finalists))))
        race_blocks = clock.until(RACE_SHARE, blocks)
        best_finalist, *_ = race(partial(fine, seed=seed), distinct, race_blocks, cost)
        report(f"best of the last race: {best_finalist}")
        if not any(result.success for result in best_finalist.results):
            specification = worlds[0].specification
            demo = f"./applr demo robot:={robot.folder} method:=dwa world:={specification}"
            raise ApplrError(
                f"no set arrives on any course, so there is nothing to compare: {demo} shows why"
            )
        # The files get short values, so that these are also driven from here on.
        short_values = []
        for parameter_value in best_finalist.theta:
            short_values.append(float(f"{parameter_value:.{DIGITS}g}"))
        theta = space.clip(short_values)

        # Each changed parameter gets an equal part of the time until the end of the pruning.
        changed = np.count_nonzero(theta != space.theta0)
        end_shares = np.linspace(clock.spent(), PRUNE_SHARE, 1 + changed)[1:].tolist()
        prune_blocks = blocks_of(len(worlds), seed + 1)[:PRUNE_BLOCKS]

        def next_turn() -> Iterator[Block]:
            show(f"reverting parameters to the default, one by one: {len(end_shares)} left")
            return clock.until(end_shares.pop(0), prune_blocks)

        theta, effects = prune_parameters(
            space, partial(fine, seed=seed + 1), theta, next_turn, cost
        )
        return whole.fill(theta), effects


def warm_starts(robot: Robot) -> np.ndarray:
    """Return initial parameter sets (k, n) of search_space().

    They are the defaults, the robot's static.json, and the sets of included robots. Each set is
    also tried half-way to the robot's defaults.
    """
    space = search_space(robot)
    defaults = space.to_action(space.theta0)
    starts = [space.theta0]
    # The robot's own set lets a finished search go on from its result.
    robots = [robot]
    for name in NAMES:
        if name != robot.name:
            robots.append(load(name))
    for other_robot in robots:
        # Some have no set, a set of other parameters, or a laser that does not face ahead.
        with suppress(ApplrError):
            shipped_set = space_of(other_robot).read(methods.shipped(methods.SET, other_robot))
            action = transferred(shipped_set.theta, other_robot, robot)
            if obstacle_range.NAME in space.names:
                action = np.append(action, range_action(shipped_set, other_robot, space, robot))
            starts.append(space.to_theta(action))
            starts.append(space.to_theta(0.5 * (action + defaults)))
    return np.array(starts)


def range_action(
    parameter_set: ParameterSet, from_robot: Robot, space: Space, to_robot: Robot
) -> float:
    """Return the action of the obstacle range, the last parameter of `space`, in a robot's set.

    It is scaled by size. A set without a range has the one in the files.
    """
    theta = space.theta0.copy()
    if parameter_set.obstacle_range is not None:
        scale = to_robot.world_scale / from_robot.world_scale
        theta[-1] = scale * parameter_set.obstacle_range
    return float(space.to_action(theta)[-1])


def transferred(theta: np.ndarray, from_robot: Robot, to_robot: Robot) -> np.ndarray:
    """Return the action (m,) of one robot that corresponds to the parameter set (n,) of another.

    A parameter of the dimensionless encoding is scaled by size and speed, any other keeps its place
    in its range. A parameter that the first robot lacks takes the encoding's value.
    """
    from_space = space_of(from_robot)
    to_space = space_of(to_robot)
    from_action = from_space.to_action(theta)
    if from_robot is to_robot:
        return from_action
    # The period scales only observations, which are not used here.
    from_encoding = DimensionlessEncoding(from_robot, period=1.0)
    to_encoding = DimensionlessEncoding(to_robot, period=1.0)
    scaled = to_space.to_action(to_encoding.theta(from_encoding.action(theta)))
    # Places within the ranges, from -1 to 1.
    unscaled = dict(zip(from_space.names, from_action))
    action = np.array(scaled)
    for index, name in enumerate(to_space.names):
        if name not in to_encoding.chosen and name in unscaled:
            action[index] = unscaled[name]
    return action
