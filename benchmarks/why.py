"""Figures of `./applr why` for docs/explanation/results.md: `python -m benchmarks.why`.

With bags of the Jackal, print the share of their commands that the replay reproduces. Without,
plant one fault at a time in a simulated robot, ask `./applr why` about each drive that the fault
makes fail or take 1.5 times as long, follow the advice, and drive before and after with fresh
seeds. Each drive is a row of docs/results/planted.csv, where the next call goes on;
docs/results/advice.csv counts them.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.outcome import Outcome
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL, Robot, load
from applr_ros1.robots.geometry import bounding_box
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.fitting import Fittable, plans_of
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import replay_of
from applr_ros1.why.rerun import RerunPlanner
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import simulated
from training.attempts.candidates import Candidate, candidates_of, with_changes
from training.attempts.trials import RANDOM
from training.why import __main__ as why
from training.why.driven import with_trials
from training.why.recorded import recording_of
from training.why.remedies import driven_trials, possible_guesses
from training.workers.pool import Pool

RESULTS = Path(__file__).parents[1] / "docs" / "results"
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
# Largest number of drives per fault, so that no parameter counts much more than another
DRIVES_PER_FAULT = 4
# One sound drive for this many turns through the robots: it shows what is advised without a fault.
SOUND_EVERY = 5
TRAJECTORY = "TrajectoryPlannerROS"
DWA = "DWAPlannerROS"
# Columns of docs/results/advice.csv, in the order of `_summary`
COUNTED = (
    "robot",
    "drives",
    "parameters",
    "advised",
    "helps",
    "harms",
    "named",
    "random helps",
    "random harms",
    "undone helps",
)
COSTMAPS = ("local_costmap", "global_costmap")
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

    @property
    def counts(self) -> bool:
        """True if the fault changes the drive."""
        return self.advised != ""

    @property
    def ratio(self) -> float:
        """Ratio of the mean times after and before."""
        return float(self.after) / float(self.before)


# -- faults ----------------------------------------------------------------------------------------
def faults(robot: Robot) -> List[Candidate]:
    """Return the faults that are planted in a robot."""
    planner = robot.local_planner
    planted_faults = []
    for spoilt_values in PLANNER_FAULTS[planner]:
        changes = []
        for parameter_name, spoilt_value in spoilt_values.items():
            changes.append(Change(planner, parameter_name, None, spoilt_value))
        planted_faults.append(_fault(changes))
    return planted_faults + faults_of_files(robot)


def faults_of_files(robot: Robot) -> List[Candidate]:
    """Return faults of values that stand in files, in both costmaps where they have them."""
    tree = robot.all_parameters()
    scale = robot.world_scale
    outline = bounding_box(robot)
    corners = (
        (outline.back, outline.right),
        (outline.back, outline.left),
        (outline.front, outline.left),
        (outline.front, outline.right),
    )
    doubled_footprint = [[2.0 * x, 2.0 * y] for x, y in corners]
    planted_faults = []

    # The robot takes itself for larger than it is.
    planted_faults.append(_fault_in(COSTMAPS, "footprint", str(doubled_footprint)))
    planted_faults.append(_fault_in(COSTMAPS, "footprint_padding", 0.3 * scale))

    # The inflation reaches too far, or its cost falls too slowly.
    for parameter_name, spoilt_value in (
        ("inflation_radius", 3.0 * scale),
        ("cost_scaling_factor", 0.3),
    ):
        layer_paths = []
        for costmap in COSTMAPS:
            layer_paths += _layers_with(tree, costmap, parameter_name)
        planted_faults.append(_fault_in(layer_paths, parameter_name, spoilt_value))

    # The costmaps hear only of obstacles that are close.
    source_paths = []
    for costmap in COSTMAPS:
        source_paths += _sources_of(tree, costmap)
    planted_faults.append(_fault_in(source_paths, "obstacle_range", 0.4 * scale))
    planted_faults.append(_fault_in(source_paths, "raytrace_range", 0.4 * scale))

    planted_faults.append(_fault_in([""], "controller_frequency", 2.0))

    # The local costmap ends before the trajectories do.
    window_size = 1.5 * scale
    window_sides = ("width", "height")
    planted_faults.append(
        _fault(
            [Change("local_costmap", side_name, None, window_size) for side_name in window_sides]
        )
    )
    return planted_faults


def _fault_in(servers: Sequence[str], parameter_name: str, spoilt_value: Any) -> Candidate:
    """Return the fault that spoils the same parameter below several servers."""
    return _fault([Change(server, parameter_name, None, spoilt_value) for server in servers])


def _fault(changes: Sequence[Change]) -> Candidate:
    # A parameter of both costmaps is written once.
    spoilt_values = {change.name: change.after for change in changes}
    phrases = [f"{name} {spoilt_value}" for name, spoilt_value in spoilt_values.items()]
    return Candidate(tuple(changes), ", ".join(phrases))


def _layers_with(tree: Dict[str, Any], costmap: str, name: str) -> List[str]:
    """Return the paths of a costmap's layers that have a parameter."""
    layer_paths = []
    for layer_name, section in tree[costmap].items():
        if isinstance(section, dict) and name in section:
            layer_paths.append(f"{costmap}/{layer_name}")
    return layer_paths


def _sources_of(tree: Dict[str, Any], path: str) -> List[str]:
    """Return the paths of the observation sources below a costmap."""
    section: Any = tree
    for section_name in path.split("/"):
        section = section[section_name]
    source_paths = []
    # costmap_2d lets a source have any name: its parameters tell it from a layer.
    if "sensor_frame" in section or "marking" in section:
        source_paths.append(path)
    for parameter_name, parameter_value in section.items():
        if isinstance(parameter_value, dict):
            source_paths += _sources_of(tree, f"{path}/{parameter_name}")
    return source_paths


def _random_change(robot: Robot, rng: np.random.Generator) -> Candidate:
    """Return half or twice one value of the planner, or a change of the files."""
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
    change = Change(server, chosen_name, earlier_value, scaled_value)
    candidates = [Candidate((change,)), *candidates_of(robot).unusual]
    return candidates[int(rng.integers(min(2, len(candidates))))]


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


class Bench:
    """Drives and judges, and remembers what sound robots do."""

    def __init__(self) -> None:
        self._usual: Dict[Tuple[str, int], float] = {}
        self._sound: Dict[Tuple[str, int], float] = {}

    def usual(self, name: str, world: int) -> float:
        """Return the time of the sound drive [s]; LIMIT_S if it fails."""
        if (name, world) not in self._usual:
            self._usual[name, world] = self._recorded(load(name), world).seconds
        return self._usual[name, world]

    def judged(self, name: str, world: int, fault: Optional[Candidate]) -> Planted:
        """Return the row of one fault, or of the sound robot."""
        sound_robot = load(name)
        usual_time = self.usual(name, world)
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
            recording = self._recorded(robot, world)
        except ApplrError as error:  # move_base refuses the value.
            return table_row._replace(answer=str(error))
        table_row = table_row._replace(recorded=recording.seconds)
        # Nobody would ask about a drive that the fault hardly changes.
        if fault is not None and recording.seconds < SLOWER * usual_time:
            return table_row
        return self._answered(table_row, robot, recording.drive, fault)

    def _recorded(self, robot: Robot, world: int) -> RecordedDrive:
        drive, outcome = simulated(robot, f"generated:{world}", limit=LIMIT_S, seed=RECORDED_SEED)
        return RecordedDrive(drive, round(_counted_time(outcome), 2))

    def _answered(
        self, table_row: Planted, robot: Robot, drive: Drive, fault: Optional[Candidate]
    ) -> Planted:
        """Return the row with the answer to a drive, and with the drives that follow its advice."""
        began = process_time()
        planner = RerunPlanner(robot)
        # The simulated drive has plans in the frame of the odometry alone: there is no tf.
        in_odometry = replace(drive, frames={"routes": [drive.frame]})
        columns = in_odometry.require(Fittable)
        plans = plans_of(in_odometry, columns.planned, columns.odometry, None, planner)
        drive = replace(drive, plans=plans)
        trials = None
        guess: Sequence[Change] = ()
        answer_in_words = "no command has a plan"
        replay = None
        # Without a cycle the planner never had a path, and the command says so.
        with suppress(ApplrError):
            replay = replay_of(Recording.of(drive, robot), planner)
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
        world_of_robot = (table_row.robot, table_row.world)
        if world_of_robot not in self._sound:
            self._sound[world_of_robot] = mean_time(load(table_row.robot), table_row.world)
        return table_row._replace(
            random=mean_time(randomly_changed, table_row.world),
            undone=self._sound[world_of_robot],
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
def attempts(
    worlds: Sequence[int], robots: Sequence[str]
) -> Iterator[Tuple[str, int, Optional[Candidate]]]:
    """Yield robots, worlds and faults in an order that spreads all three evenly."""
    shuffled_faults = {}
    for robot_index, robot_name in enumerate(robots):
        rng = np.random.default_rng(robot_index)
        robot_faults = faults(load(robot_name))
        fault_order = rng.permutation(len(robot_faults))
        shuffled_faults[robot_name] = [robot_faults[fault_index] for fault_index in fault_order]
    most_faults = max(map(len, shuffled_faults.values()))
    for turn in range(most_faults * len(worlds)):
        for robot_name in robots:
            robot_faults = shuffled_faults[robot_name]
            fault = robot_faults[turn % len(robot_faults)]
            # Another world for each fault, and for each turn through all of them.
            world = worlds[(turn + turn // len(robot_faults)) % len(worlds)]
            yield robot_name, world, fault
        if turn % SOUND_EVERY == 0:
            sound_index = turn // SOUND_EVERY
            yield robots[sound_index % len(robots)], worlds[sound_index % len(worlds)], None


def stored(path: Path) -> List[Planted]:
    """Return the rows of a table; none if there is no table yet."""
    if not path.exists():
        return []
    table_rows = []
    with path.open(newline="", encoding="utf-8") as table_file:
        for texts in csv.DictReader(table_file):
            fields: Dict[str, Any] = dict(texts)
            fields["world"] = int(fields["world"])
            for time_field in ("usual", "recorded"):
                fields[time_field] = float(fields[time_field])
            for flag_field in ("advised", "named"):
                # "" stands for a drive about which nobody asked.
                if fields[flag_field]:
                    fields[flag_field] = int(fields[flag_field])
            table_rows.append(Planted(**fields))
    return table_rows


def all_planted(worlds: Sequence[int], robots: Sequence[str], count: int, path: Path) -> None:
    """Append rows to a table until it has a number of drives with a fault that changes them."""
    table_rows = stored(path)
    known_drives = {(table_row.robot, table_row.world, table_row.fault) for table_row in table_rows}
    if not path.exists():
        _append(path, Planted._fields)
    bench = Bench()
    # Folders of other robots follow, so that those of the table have the same faults as without.
    all_robots = list(dict.fromkeys([*ROBOTS, *robots]))
    for robot_name, world, fault in attempts(worlds, all_robots):
        planted_drives = Counter(row.fault for row in table_rows if row.counts and row.fault)
        planted_count = sum(planted_drives.values())
        if planted_count >= count:
            break
        fault_words = str(fault) if fault is not None else ""
        if robot_name not in robots or (robot_name, world, fault_words) in known_drives:
            continue
        if planted_drives[fault_words] >= DRIVES_PER_FAULT:
            continue
        # Where the sound robot fails, a failure says nothing about the fault.
        if bench.usual(robot_name, world) >= LIMIT_S:
            continue
        began = perf_counter()
        table_row = bench.judged(robot_name, world, fault)
        table_rows.append(table_row)
        known_drives.add((robot_name, world, fault_words))
        # Written at once, because the next call goes on where this one is interrupted.
        _append(path, table_row)
        print(f"{planted_count} {perf_counter() - began:.0f} s: {table_row}", flush=True)
    table(table_rows)


def _append(path: Path, cells: Sequence[Any]) -> None:
    """Append a line to a table."""
    with path.open("a", newline="", encoding="utf-8") as table_file:
        csv.writer(table_file, lineterminator="\n").writerow(cells)


def table(rows: Sequence[Planted]) -> None:
    """Write docs/results/advice.csv: what the rows count."""
    counted_rows = [row for row in rows if row.counts]
    planted_rows = [row for row in counted_rows if row.fault]
    sound_rows = [row for row in counted_rows if not row.fault]
    advice_file = RESULTS / "advice.csv"
    with advice_file.open("w", newline="", encoding="utf-8") as table_file:
        writer = csv.writer(table_file, lineterminator="\n")
        writer.writerow(COUNTED)
        for robot_name in dict.fromkeys(row.robot for row in planted_rows):
            robot_rows = [row for row in planted_rows if row.robot == robot_name]
            writer.writerow(_summary(robot_name, robot_rows))
        writer.writerow(_summary("all", planted_rows))
        writer.writerow(_summary("all, without a fault", sound_rows))
    print(advice_file.read_text(encoding="utf-8"))


def _summary(name: str, rows: Sequence[Planted]) -> List[Any]:
    """Return a line of the table."""
    parameters = set()
    advised_ratios = []
    random_ratios = []
    named_count = 0
    helped_if_undone = 0
    for table_row in rows:
        parameters.update(table_row.parameters.split("+"))
        if table_row.advised:
            advised_ratios.append(table_row.ratio)
        random_ratios.append(float(table_row.random) / float(table_row.before))
        named_count += table_row.named
        helped_if_undone += float(table_row.undone) <= HELPED * float(table_row.before)
    # A sound drive has no spoilt parameter.
    parameters.discard("")
    return [
        name,
        len(rows),
        len(parameters),
        len(advised_ratios),
        sum(ratio <= HELPED for ratio in advised_ratios),
        sum(ratio >= HARMED for ratio in advised_ratios),
        named_count,
        sum(ratio <= HELPED for ratio in random_ratios),
        sum(ratio >= HARMED for ratio in random_ratios),
        helped_if_undone,
    ]


def main(arguments: Sequence[str]) -> None:
    """Print the shares of bags, or plant faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bags", nargs="*")
    parser.add_argument(
        "--drives", type=int, default=60, help="planted drives that change the drive"
    )
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--worlds", type=int, nargs="*", default=list(JUDGING))
    parser.add_argument("--table", type=Path, default=RESULTS / "planted.csv")
    options = parser.parse_args(arguments)
    for bag_path in options.bags:
        reproduced(bag_path)
    if not options.bags:
        all_planted(options.worlds, options.robots, options.drives, options.table)


if __name__ == "__main__":
    main(sys.argv[1:])
