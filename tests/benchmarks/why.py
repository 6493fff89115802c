"""Figures of `./applr why` for docs/explanation/results.md: `python -m tests.benchmarks.why [BAG
...]`.

With bags of the Jackal, print the share of their commands that the replay reproduces. Without,
plant one fault at a time in a simulated robot, ask `./applr why` about each drive that the fault
makes fail or 1.5 times as long, follow the advice, and drive before and after with fresh seeds: a
line per drive, and the table docs/results/advice.csv.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL, Robot, load
from applr_ros1.robots.geometry import bounding_box
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import simulated
from training.why import __main__ as why
from training.why.candidates import Candidate, file_candidates, with_changes
from training.why.diagnosis import diagnose
from training.why.replay import Replay
from training.why.whole_drives import RANDOM
from training.workers.pool import Pool

# A fault counts if the drive takes this much longer than the sound one, or fails
SLOWER = 1.5
LIMIT_S = 60.0
RECORDED_SEED = 0
FRESH_SEEDS = (101, 102, 103)
# ratios of the mean times after and before
HELPED = 0.9
HARMED = 1.1
JUDGING = (
    5,
    17,
    23,
    28,
    45,
    61,
    76,
    88,
)  # worlds of the table; rules were chosen with 3, 11, 40 and 7
ROBOTS = "jackal", "turtlebot3_waffle_pi", "husky"
TRAJECTORY = "TrajectoryPlannerROS"
DWA = "DWAPlannerROS"
EQUAL = {  # equals on the page of the C++ planner
    "inflation_radius": ("occdist_scale", "cost_scaling_factor"),
    "cost_scaling_factor": ("occdist_scale", "inflation_radius"),
    "occdist_scale": ("inflation_radius", "cost_scaling_factor"),
    "path_distance_bias": ("goal_distance_bias",),
    "goal_distance_bias": ("path_distance_bias",),
    "scaling_speed": ("max_scaling_factor",),
    "footprint": ("footprint_padding",),
    "footprint_padding": ("footprint",),
}
# Faults {parameter: value} of the local planner.
PLANNER_FAULTS: Dict[str, List[Dict[str, Any]]] = {
    TRAJECTORY: [
        {"sim_time": 4.0},
        {"sim_time": 0.3},
        {"occdist_scale": 0.8},
        {"path_distance_bias": 5.0},
        {"goal_distance_bias": 0.1},
        {"vx_samples": 1},
        {"vtheta_samples": 2},
        {"max_vel_theta": 0.3, "min_vel_theta": -0.3},
        {"acc_lim_theta": 0.5},
        {"acc_lim_x": 0.1},
        {"oscillation_reset_dist": 2.0},
        {"heading_lookahead": 2.0},
    ],
    DWA: [
        {"sim_time": 5.0},
        {"sim_time": 0.4},
        {"occdist_scale": 1.0},
        {"path_distance_bias": 400.0},
        {"goal_distance_bias": 1.0},
        {"vx_samples": 2},
        {"vth_samples": 2},
        {"max_vel_theta": 0.3, "min_vel_theta": 0.1},
        {"acc_lim_theta": 0.3},
        {"acc_lim_x": 0.1},
        {"oscillation_reset_dist": 1.0},
        {"forward_point_distance": 1.2},
        {"scaling_speed": 0.01, "max_scaling_factor": 3.0},
        {"twirling_scale": 20.0},
    ],
}


class Planted(NamedTuple):
    """Result of one planted fault.

    Attributes:
        robot: Name of the robot.
        world: Number of the world.
        fault: Names of the spoilt parameters; empty for a sound drive.
        given: Whether advice was given.
        named: Whether the first named parameter is the spoilt one or its equal.
        before: Mean time with the fault [s], with fresh seeds.
        after: Mean time after following the advice [s]; `before` without advice.
        random: Mean time after a random change.
        undone: Mean time without the fault.
        seconds: Time that the answer took [s].
        line: Advice, or the first line.
    """

    robot: str
    world: int
    fault: str
    given: bool
    named: bool
    before: float
    after: float
    random: float
    undone: float
    seconds: float
    line: str


def faults(robot: Robot) -> List[Candidate]:
    """Return the faults that are planted in a robot."""
    planner = robot.local_planner
    tree = robot.all_parameters()
    planted = []
    for fault in PLANNER_FAULTS[planner]:
        changes = [Change(planner, name, None, value) for name, value in fault.items()]
        planted.append(Candidate(tuple(changes)))
    scale = robot.world_scale
    for name, value in (("inflation_radius", 1.6 * scale), ("cost_scaling_factor", 0.5)):
        changes = []
        for costmap in ("local_costmap", "global_costmap"):
            for layer, section in tree[costmap].items():
                if isinstance(section, dict) and name in section:
                    changes.append(Change(f"{costmap}/{layer}", name, None, value))
        planted.append(Candidate(tuple(changes)))
    back, front, right, left = bounding_box(robot)
    wide = [
        [1.6 * x, 1.6 * y] for x, y in ((back, right), (back, left), (front, left), (front, right))
    ]
    in_files = {"footprint": str(wide), "footprint_padding": 0.25 * scale}
    for name, value in in_files.items():
        changes = [
            Change(costmap, name, None, value) for costmap in ("local_costmap", "global_costmap")
        ]
        planted.append(Candidate(tuple(changes)))
    planted.append(Candidate((Change("", "controller_frequency", None, 3.0),)))
    size = 2.0 * scale
    window = (
        Change("local_costmap", "width", None, size),
        Change("local_costmap", "height", None, size),
    )
    planted.append(Candidate(window))
    for name in ("obstacle_range", "raytrace_range"):
        changes = []
        for costmap in ("local_costmap", "global_costmap"):
            for path in _sources_of(tree, costmap):
                changes.append(Change(path, name, None, 0.6 * scale))
        planted.append(Candidate(tuple(changes)))
    return planted


def _sources_of(tree: Dict[str, Any], path: str) -> List[str]:
    """Return the paths of the observation sources below a costmap."""
    section: Any = tree
    for part in path.split("/"):
        section = section[part]
    found = [path] if "sensor_frame" in section or "marking" in section else []
    for name, value in section.items():
        if isinstance(value, dict):
            found += _sources_of(tree, f"{path}/{name}")
    return found


def mean_time(robot: Robot, world: int) -> float:
    """Return the mean time of drives with fresh seeds [s]; a failure or a contact counts
    LIMIT_S.
    """
    times = []
    for seed in FRESH_SEEDS:
        _, outcome = simulated(
            robot, f"generated:{world}", limit=LIMIT_S, seed=seed, simulator=_deviating
        )
        arrived = outcome.success and not outcome.collided
        times.append(outcome.time_s if arrived else LIMIT_S)
    return float(np.mean(times))


def _deviating(robot: Robot) -> KinematicSimulator:
    """Return a simulator whose robot deviates a little from the nominal one, differently for each
    seed.
    """
    return KinematicSimulator(robot, **RANDOM)


def judged(name: str, world: int, fault: Optional[Candidate], usual: float) -> Optional[Planted]:
    """Return the result of one fault, or None if the drive takes hardly more than the usual time
    [s].
    """
    sound = load(name)
    robot = with_changes(sound, fault.changes, f"{name} with a fault") if fault else sound
    drive, outcome = simulated(robot, f"generated:{world}", limit=LIMIT_S, seed=RECORDED_SEED)
    if fault and outcome.success and outcome.time_s < SLOWER * usual:
        return None
    began = perf_counter()
    replay = Replay(robot)
    replay.run(drive)
    with Pool(0) as pool:
        diagnosis = diagnose(replay, None, pool)
    seconds = perf_counter() - began
    lines = why.lines_of(diagnosis)
    remedy = diagnosis.trials.remedy if diagnosis.trials else None
    before = mean_time(robot, world)
    after = before
    named: List[str] = []
    if remedy is not None and remedy.candidate is not None:
        named = remedy.candidate.names
        after = mean_time(with_changes(robot, remedy.candidate.changes, "followed"), world)
    elif diagnosis.guesses:
        named = [diagnosis.guesses[0].change.name]
    spoilt = set(fault.names) if fault else set()
    for parameter in list(spoilt):
        spoilt |= set(EQUAL.get(parameter, ()))
    rng = np.random.default_rng([world, len(spoilt)])
    random = _random_change(robot, rng)
    return Planted(
        name,
        world,
        "+".join(fault.names) if fault else "",
        remedy is not None,
        bool(spoilt & set(named)),
        before,
        after,
        mean_time(with_changes(robot, random.changes, "random"), world) if fault else before,
        mean_time(sound, world) if fault else before,
        seconds,
        " | ".join(lines[:3]),
    )


def _random_change(robot: Robot, rng: np.random.Generator) -> Candidate:
    """Return half or twice one value, of the planner or of the files."""
    server = robot.local_planner
    values = robot.all_parameters()[server]
    numbers = {
        k: v for k, v in values.items() if isinstance(v, float) and v > 0 and "vel_" not in k
    }
    name = sorted(numbers)[int(rng.integers(len(numbers)))]
    change = Change(server, name, numbers[name], numbers[name] * float(rng.choice([0.5, 2.0])))
    live = Candidate((change,))
    return [live, *file_candidates(robot)][int(rng.integers(2))]


def reproduced(path: str) -> None:
    """Print the share of a bag's commands that the replay reproduces."""
    began = process_time()
    replay = Replay(JACKAL)
    replay.run(why.drive_of(Path(path), why.WhyOptions(bag=[path], robot=JACKAL)))
    near = sum(cycle.error < 0.1 for cycle in replay.cycles) / len(replay.cycles)
    spent = process_time() - began
    print(
        f"{path}: {len(replay.cycles)} cycles, {replay.share:.1%} to 1e-6, "
        f"{near:.1%} within 0.1, {spent:.1f} s of one core"
    )


def all_planted(worlds: List[int]) -> None:
    """Print a line per planted drive, and the table."""
    rows: List[Planted] = []
    with ProcessPoolExecutor(2) as pool:
        calls = []
        for name, world, usual in _sound_drives(worlds):
            for fault in [None, *faults(load(name))]:
                calls.append(pool.submit(judged, name, world, fault, usual))
        for call in as_completed(calls):
            error = call.exception()
            if error is not None:
                print(f"not driven: {error}", flush=True)
                continue
            row = call.result()
            if row is not None:
                rows.append(row)
                print(row, flush=True)
    print(
        "robot,drives,parameters,advised,helped,harmed,named,random helped,random harmed,undone "
        "helped"
    )
    for name in (*ROBOTS, ""):
        print(_summary(name, [row for row in rows if row.fault and row.robot.startswith(name)]))
    for row in rows:
        if not row.fault:
            print(f"sound: {row}")


def _sound_drives(worlds: List[int]) -> Iterator[Tuple[str, int, float]]:
    """Yield the robots and worlds in which a robot without a fault arrives, with its time [s]."""
    for world in worlds:
        for name in ROBOTS:
            _, usual = simulated(
                load(name), f"generated:{world}", limit=LIMIT_S, seed=RECORDED_SEED
            )
            if usual.success:
                yield name, world, usual.time_s


def _summary(name: str, rows: List[Planted]) -> str:
    """Return a line of the table."""
    advised = [row for row in rows if row.given]
    counts = (
        len(rows),
        len({row.fault for row in rows}),
        len(advised),
        sum(row.after <= HELPED * row.before for row in advised),
        sum(row.after >= HARMED * row.before for row in advised),
        sum(row.named for row in rows),
        sum(row.random <= HELPED * row.before for row in rows),
        sum(row.random >= HARMED * row.before for row in rows),
        sum(row.undone <= HELPED * row.before for row in rows),
    )
    return ",".join([name or "all", *map(str, counts)])


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:] if argument.isdigit()]
    bags = [argument for argument in sys.argv[1:] if not argument.isdigit()]
    for bag in bags:
        reproduced(bag)
    if not bags:
        all_planted(numbers or list(JUDGING))
