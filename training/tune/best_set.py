"""Search for the best parameter set of a robot in a given time: CMA-ES in two simulators, a last race, and pruning.

tune_robot.py runs the search. Its algorithms are in search.py.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy import methods
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot, load
from training.env.episode import TIME_LIMIT
from training.env.settings import CHALLENGE, TrialSettings
from training.evaluate.drive import drive
from training.evaluate.loaded import loadable_space
from training.evaluate.runner import run
from training.evaluate.score import AIMS, Baseline
from training.evaluate.table import Trials
from training.evaluate.trial import Result
from training.tune.clock import Clock
from training.tune.options import TuneOptions
from training.tune.search import Block, Evaluate, blocks_of, plan_sets, prune_parameters, race, search
from training.workers.pool import Pool
from worlds import World

# ends of the stages as shares of the time: search in the kinematic simulator, search in pybullet, race of the best
# parameter sets, pruning; the verdicts take the rest
COARSE_SHARE, SEARCH_SHARE, RACE_SHARE, PRUNE_SHARE = 0.25, 0.62, 0.74, 0.86
SEARCH: Dict[str, Any] = {"sigma": 0.3, "population": 12, "worlds_per_set": 20}  # arguments of search()
COARSE, FINE = "kinematic", "pybullet"  # simulators of the first part of the search, and of everything after it
LIMIT_OPTIMAL_TIMES = 10.0  # time limit of a drive of the search, in optimal times of the longest course
FINALISTS = 5  # number of generations whose means enter the last race; their winners are often only lucky
PRUNE_BLOCKS = 6  # largest number of blocks of trials that decide on reverting a parameter
LINES_S = 10.0, 15.0  # time until the first progress line, and interval between further lines [s]
DRAWN: Dict[str, Any] = {  # randomisation of the drives, except of the ground
    **{"start_xy": 0.05, "start_yaw": 0.1, "scan_noise": [1, 5], "latency": [0, 0.05]},
    **{"friction": [0.8, 1.2], "slip": [0.7, 1.4], "odometry": [0.5, 2]},
}
show = partial(print, flush=True)


def drives_of(robot: Robot, worlds: Sequence[Tuple[str, str, World]]) -> TrialSettings:
    """Return the trial settings of a search in these worlds; best_set() adds the simulator."""
    farthest = max(world.course.route_m for *_, world in worlds)
    rules: Dict[str, Any] = {"protocol": CHALLENGE, "planner": CPP_LIKE, "loaded": True, "randomisation": DRAWN}
    return TrialSettings(
        robot=robot, **rules, time_limit=min(TIME_LIMIT, LIMIT_OPTIMAL_TIMES * farthest / robot.base.max_speed)
    )


def best_set(
    options: TuneOptions,
    settings: TrialSettings,
    worlds: Sequence[Tuple[str, str, World]],
    first: np.ndarray,
    table: Trials,
    clock: Clock,
) -> Tuple[np.ndarray, Dict[str, Tuple[float, ...]]]:
    """Return the best parameter set (n,) in these worlds, and the savings of each changed parameter (prune_parameters).

    Args:
        options: Options of the command.
        settings: Trial settings from drives_of().
        worlds: [(name, specification, world), ...].
        first: Parameter sets (k, n) with which the search begins, from warm_starts().
        table: Table that keeps the trials.
        clock: Clock that ends each stage.

    Raises:
        ApplrError: No set arrives on any course.
    """
    robot, seed = settings.robot, options.seed
    whole, names, aim = loadable_space(robot), [world[:2] for world in worlds], AIMS[options.for_]
    space = whole.chosen
    means: List[Array] = []
    driven: List[str] = []  # simulator of each generation

    def report(line: str) -> None:
        show(f"{options.minutes * clock.spent():4.1f} min: {line}")

    def drives(simulator: str, sets: np.ndarray, block: Block, seed: int) -> List[List[Result]]:
        """Return the results of each set in the worlds of a block. All sets drive one world before the next."""
        runner = partial(run, settings.model_copy(update={"simulator": simulator}))
        plan = plan_sets(whole, names, np.array([whole.fill(theta) for theta in sets]), block, seed, simulator)
        trials = [trial for of_world in zip(*plan) for trial in of_world]
        with announced(f"driving {len(sets)} sets on {len(block)} courses, {simulator}", show, *LINES_S):
            results = drive(pool, runner, table, trials)
        return [[results[trial] for trial in of_set] for of_set in plan]

    def rounds() -> Iterator[Evaluate]:
        """Yield the function that drives each generation, until the time of the search has passed."""
        while (spent := clock.spent()) < SEARCH_SHARE or not driven:
            driven.append(COARSE if spent < COARSE_SHARE else FINE)
            yield partial(drives, driven[-1])

    with Pool(options.workers) as pool:
        coarse, fine = partial(drives, COARSE), partial(drives, FINE)
        every = blocks_of(len(worlds), seed)
        (results,) = coarse(space.theta0[None], sum(every[:2], []), seed)
        cost = partial(aim.cost, robot=robot, baseline=Baseline.of(results, robot))
        begun = race(partial(coarse, seed=seed), whole.pick(first), every[:2], cost)
        report(f"best of {len(begun)} starting sets: {begun[0]}")
        starts = [one.theta for one in begun]
        for winner, mean in search(space, len(names), rounds(), starts, cost, seed=seed, **SEARCH):
            means.append(mean)
            report(f"generation {len(means)}, {driven[-1]}: {winner}")
        finalists = map(tuple, [space.theta0, *map(space.clip, starts), *means[-FINALISTS:]])
        sets = np.array(list(dict.fromkeys(finalists)))
        best = race(partial(fine, seed=seed), sets, clock.until(RACE_SHARE, every), cost)[0]
        report(f"best of the last race: {best}")
        if not any(result.success for result in best.results):
            demo = f"./applr demo robot:={robot.folder} method:=dwa world:={names[0][1]}"
            raise ApplrError(f"no set arrives on any course, so there is nothing to compare: {demo} shows why")
        theta = space.clip([float(f"{value:.4g}") for value in best.theta])
        turns = np.linspace(clock.spent(), PRUNE_SHARE, 1 + np.count_nonzero(theta != space.theta0))[1:].tolist()
        some = blocks_of(len(worlds), seed + 1)[:PRUNE_BLOCKS]

        def next_turn() -> Iterator[Block]:
            show(f"reverting to the default, one by one: {len(turns)} parameters are left")
            return clock.until(turns.pop(0), some)

        theta, saved = prune_parameters(space, partial(fine, seed=seed + 1), theta, next_turn, cost)
        return whole.fill(theta), saved


def warm_starts(robot: Robot) -> np.ndarray:
    """Return initial parameter sets (k, n): the defaults, the robot's static.json, and those of included robots.

    Each parameter set is also tried half-way to the robot's defaults. Parameter sets of other robots are scaled to the
    robot's size and speed. Parameters outside the dimensionless encoding keep their position within the range.
    """
    space, starts = space_of(robot), [space_of(robot).theta0]
    for other in (robot, *(load(name) for name in NAMES if name != robot.name)):
        with suppress(ApplrError):  # no set, a set of other parameters, or a laser that does not face ahead
            theirs, _ = space_of(other).read(methods.shipped(methods.SET, other))
            action = space_of(other).to_action(theirs)
            if other is not robot:
                there = dict(zip(space_of(other).names, action))
                encoding, their_encoding = DimensionlessEncoding(robot, 1.0), DimensionlessEncoding(other, 1.0)
                here = zip(space.names, space.to_action(encoding.theta(their_encoding.action(theirs))))
                action = np.array([at if name in encoding.chosen else there.get(name, at) for name, at in here])
            starts += [space.to_theta(action), space.to_theta(0.5 * (action + space.to_action(space.theta0)))]
    return np.array(starts)
