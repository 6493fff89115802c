"""Figures of `./applr why` for docs/explanation/results.md: `python -m tests.benchmarks.why`.

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
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL, Robot, load
from applr_ros1.robots.geometry import bounding_box
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import simulated
from training.bags.transforms import Tree
from training.why import __main__ as why
from training.why.answer import guess_of
from training.why.candidates import Candidate, file_candidates, with_changes
from training.why.diagnosis import Diagnosis, diagnose
from training.why.recorded import plans_of
from training.why.replay import Replay
from training.why.whole_drives import RANDOM
from training.workers.pool import Pool

RESULTS = Path(__file__).parents[2] / "docs" / "results"
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
ROBOTS = ("jackal", "turtlebot3_burger", "husky")
DRIVES_PER_FAULT = 4  # so that no parameter counts much more than another
SOUND_EVERY = 5  # one drive without a fault for so many rows with one
TRAJECTORY = "TrajectoryPlannerROS"
DWA = "DWAPlannerROS"
COUNTED = (  # columns of the table of counts
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
    planted = []
    for fault in PLANNER_FAULTS[planner]:
        changes = [Change(planner, name, None, value) for name, value in fault.items()]
        planted.append(_fault(changes))
    return planted + faults_of_files(robot)


def faults_of_files(robot: Robot) -> List[Candidate]:
    """Return faults of values that stand in files, in both costmaps where they have them."""
    tree = robot.all_parameters()
    scale = robot.world_scale
    box = bounding_box(robot)
    corners = (
        (box.back, box.right),
        (box.back, box.left),
        (box.front, box.left),
        (box.front, box.right),
    )
    wide = [[2.0 * x, 2.0 * y] for x, y in corners]
    planted = []
    for name, value in (("footprint", str(wide)), ("footprint_padding", 0.3 * scale)):
        planted.append(_fault([Change(costmap, name, None, value) for costmap in COSTMAPS]))
    for name, value in (("inflation_radius", 3.0 * scale), ("cost_scaling_factor", 0.3)):
        layers = [path for costmap in COSTMAPS for path in _layers_with(tree, costmap, name)]
        planted.append(_fault([Change(path, name, None, value) for path in layers]))
    for name in ("obstacle_range", "raytrace_range"):
        sources = [path for costmap in COSTMAPS for path in _sources_of(tree, costmap)]
        planted.append(_fault([Change(path, name, None, 0.4 * scale) for path in sources]))
    planted.append(_fault([Change("", "controller_frequency", None, 2.0)]))
    size = 1.5 * scale
    planted.append(
        _fault([Change("local_costmap", side, None, size) for side in ("width", "height")])
    )
    return planted


def _fault(changes: Sequence[Change]) -> Candidate:
    words = {change.name: change.after for change in changes}
    return Candidate(tuple(changes), ", ".join(f"{name} {value}" for name, value in words.items()))


def _layers_with(tree: Dict[str, Any], costmap: str, name: str) -> List[str]:
    """Return the paths of a costmap's layers that have a parameter."""
    paths = []
    for layer, section in tree[costmap].items():
        if isinstance(section, dict) and name in section:
            paths.append(f"{costmap}/{layer}")
    return paths


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


def _random_change(robot: Robot, rng: np.random.Generator) -> Candidate:
    """Return half or twice one value of the planner, or a change of the files."""
    server = robot.local_planner
    values = robot.all_parameters()[server]
    names = []
    for name, value in sorted(values.items()):
        if isinstance(value, float) and value > 0 and "vel_" not in name:
            names.append(name)
    name = names[int(rng.integers(len(names)))]
    change = Change(server, name, values[name], values[name] * float(rng.choice([0.5, 2.0])))
    choices = [Candidate((change,)), *file_candidates(robot)]
    return choices[int(rng.integers(min(2, len(choices))))]


# -- drives ----------------------------------------------------------------------------------------
def _deviating(robot: Robot) -> KinematicSimulator:
    """Return a simulator whose robot deviates from the nominal one, differently for each seed."""
    return KinematicSimulator(robot, **RANDOM)


def mean_time(robot: Robot, world: int) -> float:
    """Return the mean time with fresh seeds [s]; a failure or a contact counts LIMIT_S."""
    times = []
    for seed in FRESH_SEEDS:
        _, outcome = simulated(
            robot, f"generated:{world}", limit=LIMIT_S, seed=seed, simulator=_deviating
        )
        arrived = outcome.success and not outcome.collided
        times.append(outcome.time_s if arrived else LIMIT_S)
    return round(float(np.mean(times)), 2)


class Bench:
    """Drives and judges, and remembers what sound robots do."""

    def __init__(self) -> None:
        self._usual: Dict[Tuple[str, int], float] = {}
        self._sound: Dict[Tuple[str, int], float] = {}

    def usual(self, name: str, world: int) -> float:
        """Return the time of the sound drive [s]; LIMIT_S if it fails."""
        if (name, world) not in self._usual:
            self._usual[name, world] = self._recorded(load(name), world)[1]
        return self._usual[name, world]

    def judged(self, name: str, world: int, fault: Optional[Candidate]) -> Planted:
        """Return the row of one fault, or of the sound robot."""
        sound = load(name)
        usual = self.usual(name, world)
        robot = sound
        row = Planted(name, world, "", "", usual, usual)
        if fault is not None:
            robot = with_changes(sound, fault.changes, f"{name} with a fault")
            row = row._replace(fault=str(fault), parameters="+".join(fault.names))
        try:
            drive, seconds = self._recorded(robot, world)
        except ApplrError as error:  # move_base refuses the value.
            return row._replace(answer=str(error))
        row = row._replace(recorded=seconds)
        if fault is not None and seconds < SLOWER * usual:
            return row
        return self._answered(row, robot, drive, fault)

    def _recorded(self, robot: Robot, world: int) -> Tuple[Any, float]:
        drive, outcome = simulated(robot, f"generated:{world}", limit=LIMIT_S, seed=RECORDED_SEED)
        arrived = outcome.success and not outcome.collided
        return drive, round(outcome.time_s, 2) if arrived else LIMIT_S

    def _answered(
        self, row: Planted, robot: Robot, drive: Any, fault: Optional[Candidate]
    ) -> Planted:
        began = process_time()
        replay = Replay(robot)
        in_odometry = replace(drive, frames={"routes": [drive.frame]})
        replay.run(replace(drive, plans=plans_of(in_odometry, Tree(None), robot)))
        if replay.cycles:
            with Pool(0) as pool:
                diagnosis = diagnose(replay, None, pool)
            answer = " | ".join(why.lines_of(diagnosis)[:3])
        else:  # The planner never had a path, and the command says so.
            diagnosis = Diagnosis(replay, [])
            answer = "no command has a plan"
        answered = process_time() - began

        before = mean_time(robot, row.world)
        after = before
        remedy = diagnosis.trials.remedy if diagnosis.trials else None
        if remedy is not None and remedy.candidate is not None:
            named = remedy.candidate.names
            after = mean_time(with_changes(robot, remedy.candidate.changes, "followed"), row.world)
        else:
            guess = guess_of(diagnosis)
            named = [guess.change.name] if guess is not None else []
        spoilt = set(fault.names) if fault else set()
        for parameter in list(spoilt):
            spoilt |= set(EQUAL.get(parameter, ()))
        row = row._replace(
            advised=int(remedy is not None),
            named=int(bool(spoilt & set(named))),
            before=before,
            after=after,
            random=before,
            undone=before,
            answered=round(answered, 1),
            answer=answer,
        )
        if fault is None:
            return row
        rng = np.random.default_rng([row.world, *row.fault.encode()])
        change = _random_change(robot, rng)
        if (row.robot, row.world) not in self._sound:
            self._sound[row.robot, row.world] = mean_time(load(row.robot), row.world)
        return row._replace(
            random=mean_time(with_changes(robot, change.changes, "random"), row.world),
            undone=self._sound[row.robot, row.world],
        )


def reproduced(path: str) -> None:
    """Print the share of a bag's commands that the replay reproduces."""
    began = process_time()
    replay = Replay(JACKAL)
    replay.run(why.drive_of(Path(path), why.WhyOptions(bag=[path], robot=JACKAL)))
    near = sum(cycle.error < 0.1 for cycle in replay.cycles) / replay.commands
    spent = process_time() - began
    print(
        f"{path}: {replay.commands} commands, {replay.share:.1%} to 1e-6, "
        f"{near:.1%} within 0.1, {spent:.1f} s of one core"
    )


# -- table -----------------------------------------------------------------------------------------
def attempts(worlds: Sequence[int]) -> Iterator[Tuple[str, int, Optional[Candidate]]]:
    """Yield robots, worlds and faults in an order that spreads all three evenly."""
    orders = {}
    for index, name in enumerate(ROBOTS):
        rng = np.random.default_rng(index)
        planted = faults(load(name))
        orders[name] = [planted[row] for row in rng.permutation(len(planted))]
    robots = cycle(ROBOTS)
    longest = max(map(len, orders.values()))
    for turn in range(longest * len(worlds)):
        for _ in ROBOTS:
            name = next(robots)
            planted = orders[name]
            fault = planted[turn % len(planted)]
            # Another world for each fault, and for each turn through all of them.
            world = worlds[(turn + turn // len(planted)) % len(worlds)]
            yield name, world, fault
        if turn % SOUND_EVERY == 0:
            index = turn // SOUND_EVERY
            yield ROBOTS[index % len(ROBOTS)], worlds[index % len(worlds)], None


def stored(path: Path) -> List[Planted]:
    """Return the rows of a table; none if there is no table yet."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        rows = []
        for values in csv.DictReader(file):
            row: Dict[str, Any] = dict(values)
            row["world"] = int(row["world"])
            for name in ("usual", "recorded"):
                row[name] = float(row[name])
            for name in ("advised", "named"):
                row[name] = int(row[name]) if row[name] else ""
            rows.append(Planted(**row))
    return rows


def all_planted(worlds: Sequence[int], robots: Sequence[str], count: int, path: Path) -> None:
    """Append rows to a table until it has a number of drives with a fault that changes them."""
    rows = stored(path)
    known = {(row.robot, row.world, row.fault) for row in rows}
    if not path.exists():
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow(Planted._fields)
    bench = Bench()
    for name, world, fault in attempts(worlds):
        planted = [row for row in rows if row.counts and row.fault]
        if len(planted) >= count:
            break
        words = str(fault) if fault is not None else ""
        same = [row for row in planted if row.fault == words]
        if name not in robots or (name, world, words) in known:
            continue
        if fault and len(same) >= DRIVES_PER_FAULT:
            continue
        if bench.usual(name, world) >= LIMIT_S:
            continue
        began = perf_counter()
        row = bench.judged(name, world, fault)
        rows.append(row)
        known.add((name, world, words))
        with path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow(row)
        print(f"{len(planted)} {perf_counter() - began:.0f} s: {row}", flush=True)
    table(rows)


def table(rows: Sequence[Planted]) -> None:
    """Write docs/results/advice.csv: what the rows count."""
    with (RESULTS / "advice.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COUNTED)
        for name in (*ROBOTS, ""):
            planted = [row for row in rows if row.fault and row.robot.startswith(name)]
            writer.writerow(_summary(name or "all", [row for row in planted if row.counts]))
        sound = [row for row in rows if not row.fault and row.counts]
        writer.writerow(_summary("all, without a fault", sound))
    print((RESULTS / "advice.csv").read_text(encoding="utf-8"))


def _summary(name: str, rows: Sequence[Planted]) -> List[Any]:
    """Return a line of the table."""
    advised = [row for row in rows if row.advised]
    random = [float(row.random) / float(row.before) for row in rows]
    return [
        name,
        len(rows),
        len({parameter for row in rows for parameter in row.parameters.split("+") if parameter}),
        len(advised),
        sum(row.ratio <= HELPED for row in advised),
        sum(row.ratio >= HARMED for row in advised),
        sum(row.named for row in rows),
        sum(ratio <= HELPED for ratio in random),
        sum(ratio >= HARMED for ratio in random),
        sum(float(row.undone) <= HELPED * float(row.before) for row in rows),
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
    for bag in options.bags:
        reproduced(bag)
    if not options.bags:
        all_planted(options.worlds, options.robots, options.drives, options.table)


if __name__ == "__main__":
    main(sys.argv[1:])
