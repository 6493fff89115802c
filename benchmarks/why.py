"""Figures of `./applr why` for docs/explanation/results.md: `python -m benchmarks.why`.

With bags of the Jackal, print the share of their commands that the replay reproduces. Without,
plant one fault at a time in a simulated robot, ask `./applr why` about each drive that the fault
makes fail or take 1.5 times as long, follow the advice, and drive before and after with fresh
seeds. Each drive is a row of docs/results/planted.csv, where the next call goes on;
docs/results/advice.csv counts them.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
import pandas as pd

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.outcome import Outcome
from applr_ros1.planner.parameters.layers import INFLATION_LAYER, layers
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL, Robot, load
from applr_ros1.robots.geometry import box_outline
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.fitting import Fittable, plans_of
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import replay_of
from applr_ros1.why.rerun import RerunPlanner
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import simulated
from training.attempts.candidates import Candidate, with_changes
from training.attempts.trials import RANDOM
from training.attempts.usual_values import COSTMAPS
from training.why import __main__ as why
from training.why.driven import with_trials
from training.why.recorded import recording_of
from training.why.remedies import driven_trials, possible_guesses
from training.workers.pool import Pool

RESULTS = Path(__file__).parents[1] / "docs" / "results"
PLANTED = RESULTS / "planted.csv"
# A fault counts if the drive takes this much longer than the sound one, or fails.
SLOWER = 1.5
LIMIT_S = 60.0
RECORDED_SEED = 0
FRESH_SEEDS = (101, 102, 103)
# Ratios of the mean times after and before
HELPED = 0.9
HARMED = 1.1
# Worlds of the table. Rules and sizes of faults were chosen with others.
JUDGING = (9, 14, 31, 38, 52, 69, 83, 97, 112, 126, 143, 158)
ROBOTS = ("jackal", "turtlebot3_burger", "husky", "turtlebot3_waffle_pi")
# Number of planted drives that count, and the largest one per fault, so that no parameter counts
# much more than another
DRIVES = 64
DRIVES_PER_FAULT = 4
# One sound drive for this many turns through the robots: it shows what is advised without a fault.
SOUND_EVERY = 5
TRAJECTORY = "TrajectoryPlannerROS"
DWA = "DWAPlannerROS"
# Parameters that the page of the C++ planner makes equals of each other: advice that names one of
# them is as good as advice that names the spoilt one.
EQUAL_PARAMETERS = {
    "inflation_radius": ("occdist_scale", "cost_scaling_factor"),
    "cost_scaling_factor": ("occdist_scale", "inflation_radius"),
    "occdist_scale": ("inflation_radius", "cost_scaling_factor"),
    "path_distance_bias": ("goal_distance_bias",),
    "goal_distance_bias": ("path_distance_bias",),
    "scaling_speed": ("max_scaling_factor",),
    "footprint": ("footprint_padding",),
    "footprint_padding": ("footprint",),
}
# Faults {parameter: value} of the local planner
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
        {"acc_lim_theta": 0.2},
        {"acc_lim_x": 0.1},
        {"oscillation_reset_dist": 2.0},
        {"heading_lookahead": 4.0},
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
        {"forward_point_distance": 2.0},
        {"scaling_speed": 0.01, "max_scaling_factor": 3.0},
        {"twirling_scale": 100.0},
    ],
}


class Planted(NamedTuple):
    """Row of the table: one drive.

    Attributes:
        robot: Name of the robot.
        world: Number of the world.
        fault: Spoilt values in words; "" for a sound drive.
        parameters: Names of the spoilt parameters, joined by "+".
        usual: Time of the sound drive [s].
        recorded: Time of the recorded drive [s]; LIMIT_S if it failed.
        advised: 1 if advice was given that was driven. For a fault that changes little, this and
            the following columns are "".
        named: 1 if the first parameter that the answer names is the spoilt one or its equal.
        before: Mean time with the fault and fresh seeds [s].
        after: Mean time after following the advice [s]; `before` without advice.
        random: Mean time after a random change [s].
        undone: Mean time without the fault [s].
        answered: Time that the answer took [s of one core].
        answer: First lines of the answer.
    """

    robot: str
    world: int
    fault: str
    parameters: str
    usual: float
    recorded: float
    advised: Any = ""
    named: Any = ""
    before: Any = ""
    after: Any = ""
    random: Any = ""
    undone: Any = ""
    answered: Any = ""
    answer: str = ""


# -- faults ----------------------------------------------------------------------------------------
def faults(robot: Robot) -> List[Candidate]:
    """Return the faults that are planted in a robot: in values of its planner, and of its files."""
    planner = robot.local_planner
    tree = robot.all_parameters()
    scale = robot.world_scale
    doubled_footprint = [[2.0 * x, 2.0 * y] for x, y in box_outline(robot)]
    inflations = []
    for costmap in COSTMAPS:
        for layer in layers(costmap, tree[costmap], INFLATION_LAYER):
            inflations.append(layer.path)
    sources = [source.path for source in laser_sources(tree)]
    window_size = 1.5 * scale
    spoilt: List[Tuple[Sequence[str], Dict[str, Any]]] = [
        *(([planner], values) for values in PLANNER_FAULTS[planner]),
        # The robot takes itself for larger than it is.
        (COSTMAPS, {"footprint": str(doubled_footprint)}),
        (COSTMAPS, {"footprint_padding": 0.3 * scale}),
        # The inflation reaches too far, or its cost falls too slowly.
        (inflations, {"inflation_radius": 3.0 * scale}),
        (inflations, {"cost_scaling_factor": 0.3}),
        # The costmaps hear only of obstacles that are close.
        (sources, {"obstacle_range": 0.4 * scale}),
        (sources, {"raytrace_range": 0.4 * scale}),
        ([""], {"controller_frequency": 2.0}),
        # The local costmap ends before the trajectories do.
        (["local_costmap"], {"width": window_size, "height": window_size}),
    ]
    return [_fault(servers, values) for servers, values in spoilt]


def _fault(servers: Sequence[str], values: Dict[str, Any]) -> Candidate:
    """Return the fault that spoils the same parameters below several servers."""
    changes = []
    for server in servers:
        for name, value in values.items():
            changes.append(Change(server, name, None, value))
    phrases = [f"{name} {value}" for name, value in values.items()]
    return Candidate(tuple(changes), ", ".join(phrases))


def _random_change(robot: Robot, rng: np.random.Generator) -> Candidate:
    """Return half or twice one value of the planner."""
    server = robot.local_planner
    values = robot.all_parameters()[server]
    scalable_names = []
    for parameter_name, parameter_value in sorted(values.items()):
        is_scalable = isinstance(parameter_value, float) and parameter_value > 0
        # They set the speed that is wanted: `./applr why` leaves them alone, too.
        if is_scalable and "vel_" not in parameter_name:
            scalable_names.append(parameter_name)
    chosen_name = scalable_names[int(rng.integers(len(scalable_names)))]
    earlier_value = values[chosen_name]
    scaled_value = earlier_value * float(rng.choice([0.5, 2.0]))
    return Candidate((Change(server, chosen_name, earlier_value, scaled_value),))


# -- drives ----------------------------------------------------------------------------------------
def _deviating(robot: Robot) -> KinematicSimulator:
    """Return a simulator whose robot deviates from the nominal one, differently for each seed."""
    return KinematicSimulator(robot, **RANDOM)


def mean_time(robot: Robot, world: int) -> float:
    """Return the mean time with fresh seeds [s]; a failure or a contact counts LIMIT_S."""
    drive_times = []
    for fresh_seed in FRESH_SEEDS:
        _, outcome = simulated(
            robot, f"generated:{world}", limit=LIMIT_S, seed=fresh_seed, simulator=_deviating
        )
        drive_times.append(_counted_time(outcome))
    return round(float(np.mean(drive_times)), 2)


def _counted_time(outcome: Outcome) -> float:
    """Return the time of a drive [s]; a failure or a contact counts LIMIT_S."""
    has_arrived = outcome.success and not outcome.collided
    return outcome.time_s if has_arrived else LIMIT_S


class RecordedDrive(NamedTuple):
    """A drive of which `./applr why` is asked, and its time [s]; LIMIT_S if it failed."""

    drive: Drive
    seconds: float


@lru_cache(maxsize=None)
def usual(name: str, world: int) -> float:
    """Return the time of the sound drive [s]; LIMIT_S if it fails."""
    return recorded(load(name), world).seconds


@lru_cache(maxsize=None)
def sound_mean(name: str, world: int) -> float:
    """Return mean_time() of the sound robot."""
    return mean_time(load(name), world)


def judged(name: str, world: int, fault: Optional[Candidate]) -> Planted:
    """Return the row of one fault, or of the sound robot."""
    sound_robot = load(name)
    usual_time = usual(name, world)
    robot = sound_robot
    table_row = Planted(
        robot=name,
        world=world,
        fault="",
        parameters="",
        usual=usual_time,
        recorded=usual_time,
    )
    if fault is not None:
        robot = with_changes(sound_robot, fault.changes, f"{name} with a fault")
        table_row = table_row._replace(fault=str(fault), parameters="+".join(fault.names))
    try:
        recording = recorded(robot, world)
    except ApplrError as error:  # move_base refuses the value.
        return table_row._replace(answer=str(error))
    table_row = table_row._replace(recorded=recording.seconds)
    # Nobody would ask about a drive that the fault hardly changes.
    if fault is not None and recording.seconds < SLOWER * usual_time:
        return table_row
    return _answered(table_row, robot, recording.drive, fault)


def recorded(robot: Robot, world: int) -> RecordedDrive:
    """Return a drive with the seed of the recorded drives."""
    drive, outcome = simulated(robot, f"generated:{world}", limit=LIMIT_S, seed=RECORDED_SEED)
    return RecordedDrive(drive, round(_counted_time(outcome), 2))


def _answered(
    table_row: Planted, robot: Robot, drive: Drive, fault: Optional[Candidate]
) -> Planted:
    """Return the row with the answer to a drive, and with the drives that follow its advice."""
    began = process_time()
    planner = RerunPlanner(robot)
    trials = None
    guess: Sequence[Change] = ()
    answer_in_words = "no command has a plan"
    replay = None
    # Without a cycle the planner never had a path, and the command says so.
    with suppress(ApplrError):
        # The simulated drive has plans in the frame of the odometry alone: there is no tf.
        in_odometry = replace(drive, frames={"routes": [drive.frame]})
        columns = in_odometry.require(Fittable)
        plans = plans_of(in_odometry, columns.planned, columns.odometry, None, planner)
        replay = replay_of(Recording.of(replace(drive, plans=plans), robot), planner)
    if replay is not None:
        diagnosis = diagnose(replay)
        with Pool(0) as pool:
            guesses = possible_guesses(diagnosis)
            trials = driven_trials(diagnosis, guesses, pool)
        answer = with_trials(answer_of(diagnosis, guesses), trials)
        guess = answer.guess
        answer_in_words = " | ".join(answer.lines[:3])
    answer_time = process_time() - began

    # Follow the advice. Without a change to follow, the answer may still name a parameter.
    time_before = mean_time(robot, table_row.world)
    time_after = time_before
    remedy = trials.remedy if trials else None
    if remedy is not None:
        named_parameters = remedy.candidate.names
        remedied_robot = with_changes(robot, remedy.candidate.changes, "followed")
        time_after = mean_time(remedied_robot, table_row.world)
    else:
        named_parameters = [change.name for change in guess[:1]]

    # Judge it.
    spoilt_parameters = set(fault.names) if fault else set()
    for parameter_name in list(spoilt_parameters):
        spoilt_parameters |= set(EQUAL_PARAMETERS.get(parameter_name, ()))
    table_row = table_row._replace(
        advised=int(remedy is not None),
        named=int(bool(spoilt_parameters & set(named_parameters))),
        before=time_before,
        after=time_after,
        random=time_before,
        undone=time_before,
        answered=round(answer_time, 1),
        answer=answer_in_words,
    )
    if fault is None:
        return table_row

    # Compare with a random change, and with the fault undone.
    # Seeded by the row, so that a table that goes on has the same changes as one in a piece.
    rng = np.random.default_rng([table_row.world, *table_row.fault.encode()])
    random_change = _random_change(robot, rng)
    randomly_changed = with_changes(robot, random_change.changes, "random")
    return table_row._replace(
        random=mean_time(randomly_changed, table_row.world),
        undone=sound_mean(table_row.robot, table_row.world),
    )


def reproduced(path: str) -> None:
    """Print the share of a bag's commands that the replay reproduces."""
    began = process_time()
    planner = RerunPlanner(JACKAL)
    options = why.WhyOptions(bag=[path], robot=JACKAL)
    replay = replay_of(recording_of(Path(path), options, planner), planner)
    close_share = sum(cycle.error < 0.1 for cycle in replay.cycles) / len(replay.cycles)
    processor_time = process_time() - began
    print(
        f"{path}: {len(replay.cycles)} commands, {replay.share:.1%} to 1e-6, "
        f"{close_share:.1%} within 0.1, {processor_time:.1f} s of one core"
    )


# -- table -----------------------------------------------------------------------------------------
def attempts() -> Iterator[Tuple[str, int, Optional[Candidate]]]:
    """Yield robots, worlds and faults in an order that spreads all three evenly."""
    shuffled_faults = {}
    for robot_index, robot_name in enumerate(ROBOTS):
        rng = np.random.default_rng(robot_index)
        robot_faults = faults(load(robot_name))
        fault_order = rng.permutation(len(robot_faults))
        shuffled_faults[robot_name] = [robot_faults[fault_index] for fault_index in fault_order]
    most_faults = max(map(len, shuffled_faults.values()))
    for turn in range(most_faults * len(JUDGING)):
        for robot_name in ROBOTS:
            robot_faults = shuffled_faults[robot_name]
            fault = robot_faults[turn % len(robot_faults)]
            # Another world for each fault, and for each turn through all of them.
            world = JUDGING[(turn + turn // len(robot_faults)) % len(JUDGING)]
            yield robot_name, world, fault
        if turn % SOUND_EVERY == 0:
            sound_index = turn // SOUND_EVERY
            yield ROBOTS[sound_index % len(ROBOTS)], JUDGING[sound_index % len(JUDGING)], None


def begun(path: Path, fields: Sequence[str]) -> List[Dict[str, str]]:
    """Return the rows of a table that goes on, or begin it."""
    if not path.exists():
        append(path, fields)
    with path.open(newline="", encoding="utf-8") as table_file:
        return list(csv.DictReader(table_file))


def all_planted() -> None:
    """Append rows to the table until it has DRIVES with a fault that changes them."""
    table_rows = begun(PLANTED, Planted._fields)
    known_drives = {(row["robot"], row["world"], row["fault"]) for row in table_rows}
    # Nobody asks about a drive that its fault hardly changes: it does not count.
    counted = Counter(row["fault"] for row in table_rows if row["fault"] and row["advised"])
    for robot_name, world, fault in attempts():
        if sum(counted.values()) >= DRIVES:
            break
        fault_words = str(fault or "")
        if (robot_name, str(world), fault_words) in known_drives:
            continue
        if counted[fault_words] >= DRIVES_PER_FAULT:
            continue
        # Where the sound robot fails, a failure says nothing about the fault.
        if usual(robot_name, world) >= LIMIT_S:
            continue
        began = perf_counter()
        table_row = judged(robot_name, world, fault)
        known_drives.add((robot_name, str(world), fault_words))
        if fault is not None and table_row.advised != "":
            counted[fault_words] += 1
        # Written at once, because the next call goes on where this one is interrupted.
        append(PLANTED, table_row)
        print(f"{perf_counter() - began:.0f} s: {table_row}", flush=True)


def append(path: Path, cells: Sequence[Any]) -> None:
    """Append a line to a table."""
    with path.open("a", newline="", encoding="utf-8") as table_file:
        csv.writer(table_file, lineterminator="\n").writerow(cells)


def write_advice() -> None:
    """Write docs/results/advice.csv: what the rows of planted.csv count."""
    rows = pd.read_csv(PLANTED).dropna(subset=["advised"])
    planted = rows[rows.fault.notna()]
    lines = [_summary(name, planted[planted.robot == name]) for name in planted.robot.unique()]
    lines.append(_summary("all", planted))
    lines.append(_summary("all, without a fault", rows[rows.fault.isna()]))
    pd.DataFrame(lines).to_csv(RESULTS / "advice.csv", index=False)


def _summary(name: str, rows: pd.DataFrame) -> Dict[str, Any]:
    """Return a line of the table."""
    advised = rows[rows.advised == 1]
    return {
        "robot": name,
        "drives": len(rows),
        "parameters": rows.parameters.str.split("+").explode().nunique(),
        "advised": len(advised),
        "helps": sum(advised.after <= HELPED * advised.before),
        "harms": sum(advised.after >= HARMED * advised.before),
        "named": int(rows.named.sum()),
        "random helps": sum(rows.random <= HELPED * rows.before),
        "random harms": sum(rows.random >= HARMED * rows.before),
        "undone helps": sum(rows.undone <= HELPED * rows.before),
    }


def main() -> None:
    """Print the shares of bags, or plant faults."""
    bags = sys.argv[1:]
    for bag_path in bags:
        reproduced(bag_path)
    if not bags:
        all_planted()
        write_advice()


if __name__ == "__main__":
    main()
