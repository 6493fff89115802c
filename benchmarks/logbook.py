"""Figures of the logbook for docs/explanation/results.md: `python -m benchmarks.logbook`.

Spoil two values of a simulated Jackal, record its stops in three worlds, ask the logbook of the
folder, follow its first advice, and ask again about new stops. Stops are counted with fresh seeds,
before and after both. Each folder is a row of docs/results/logbook.csv, where the next call goes
on.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any, List, NamedTuple, Optional, Sequence

from applr_ros1.robots import JACKAL, Robot
from applr_ros1.why.outside import seen_from_outside
from benchmarks.why import EQUAL_PARAMETERS, JUDGING, RESULTS, append, begun, faults
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.bags import write
from tests.support.drives import simulated
from training.attempts.candidates import Candidate, with_changes
from training.attempts.trials import RANDOM
from training.bags.read import bags_in
from training.why.common_change import CommonChange, change_for
from training.why.logbook import logbook_of
from training.why.logbook_words import lines_of
from training.why.recorded import BagAnswerOptions
from training.workers.pool import Pool

LIMIT_S = 40.0  # longest duration of a drive [s]
STOP_S = 5.0  # shortest duration of a stop, as of the black box [s]
WORLDS = 3  # number of worlds of a folder
BAGS = 40  # number of bags of a folder
WORKERS = 2  # processes that answer
TABLE = RESULTS / "logbook.csv"
FRESH_SEEDS = (1001, 1002, 1003, 1004)  # seeds with which stops are counted in each world
# Pairs of spoilt values, as benchmarks.why spells its faults
PAIRS = (
    ("max_vel_theta 0.3, min_vel_theta -0.3", "inflation_radius 3.0"),
    ("sim_time 4.0", "footprint_padding 0.3"),
    ("occdist_scale 0.8", "acc_lim_theta 0.2"),
    ("goal_distance_bias 0.1", "vx_samples 1"),
    ("path_distance_bias 5.0", "obstacle_range 0.4"),
)


class FolderRow(NamedTuple):
    """Row of the table: a folder of stops.

    Attributes:
        spoilt: Both spoilt values.
        worlds: Numbers of the worlds.
        bags: Number of bags.
        stops: Number of their stops.
        lost: Time that they cost [s].
        first: First advice; "" without one.
        is_spoilt: Whether it changes a spoilt value, or its equal.
        second: Advice about new stops after the first was followed; "" without one.
        stops_before: Stops with fresh seeds.
        stops_after: Stops with these seeds after both were followed.
        asked: Time that the first answer took [s].
        again: Time that it took again, with answers beside the bags [s].
    """

    spoilt: str
    worlds: str
    bags: int
    stops: int
    lost: float
    first: str
    is_spoilt: int
    second: str
    stops_before: int
    stops_after: int
    asked: float
    again: float


class LogbookAnswer(NamedTuple):
    """Answer of a logbook: number of stops, time lost [s], and what to change, or None."""

    stop_count: int
    lost: float
    candidate: Optional[Candidate]


def stopping_bags(folder: Path, robot: Robot, worlds: Sequence[int], first_seed: int) -> List[Path]:
    """Write bags of drives in which the robot stops, world after world, and return them."""
    bag_paths: List[Path] = []
    seed = first_seed
    # A robot that hardly stops any more has fewer.
    while len(bag_paths) < BAGS and seed < first_seed + 3 * BAGS:
        world = worlds[seed % len(worlds)]
        drive = _driven(robot, world, seed)
        if _stop_count(drive, robot):
            bag_paths.append(write(folder / f"{world}_{seed}.bag", drive, robot=robot))
        seed += 1
    return bag_paths


def _driven(robot: Robot, world: int, seed: int) -> Any:
    """Return a drive of a robot that deviates from the nominal one."""

    def deviating(simulated_robot: Robot) -> KinematicSimulator:
        return KinematicSimulator(simulated_robot, **RANDOM)

    drive, _ = simulated(robot, f"generated:{world}", LIMIT_S, seed, deviating)
    return drive


def _stop_count(drive: Any, robot: Robot) -> int:
    """Return the number of stops of a drive."""
    events = seen_from_outside(drive, drive.odometry, robot).events
    return sum(event.seconds >= STOP_S for event in events)


def fresh_stops(robot: Robot, worlds: Sequence[int]) -> int:
    """Return the number of stops with fresh seeds."""
    stop_count = 0
    for world in worlds:
        for seed in FRESH_SEEDS:
            stop_count += _stop_count(_driven(robot, world, seed), robot)
    return stop_count


def asked(bag_paths: Sequence[Path], robot: Robot) -> LogbookAnswer:
    """Return what the logbook of some bags says."""
    options = BagAnswerOptions(robot=robot)
    with Pool(WORKERS) as pool:
        logbook = logbook_of(bag_paths, options, pool, lambda calls, total, done: calls)
        change: Optional[CommonChange] = change_for(logbook, options, pool, lambda: None)
    print("\n".join(lines_of(logbook, change)), flush=True)
    remedy = change.trials.remedy if change is not None else None
    candidate = remedy.candidate if remedy is not None else None
    return LogbookAnswer(len(logbook.stops), logbook.lost, candidate)


def folder_row(spoilt: Sequence[Candidate], worlds: Sequence[int]) -> FolderRow:
    """Return the row of a folder with stops of a robot with two spoilt values."""
    changes = [change for fault in spoilt for change in fault.changes]
    robot = with_changes(JACKAL, changes, "jackal")
    names = {name for fault in spoilt for name in fault.names}
    for name in list(names):
        names |= set(EQUAL_PARAMETERS.get(name, ()))
    with tempfile.TemporaryDirectory() as folder:
        # The stops, and the logbook twice
        stopping_bags(Path(folder), robot, worlds, first_seed=0)
        bag_paths = bags_in([folder])
        began = perf_counter()
        first = asked(bag_paths, robot)
        answered = perf_counter()
        asked(bag_paths, robot)
        answered_again = perf_counter()
    followed = _following(robot, first.candidate)
    second: Optional[LogbookAnswer] = None
    with tempfile.TemporaryDirectory() as folder:
        # New stops after the first advice
        if stopping_bags(Path(folder), followed, worlds, first_seed=500):
            second = asked(bags_in([folder]), followed)
    both_followed = _following(followed, second.candidate if second else None)
    return FolderRow(
        spoilt="; ".join(map(str, spoilt)),
        worlds=" ".join(map(str, worlds)),
        bags=len(bag_paths),
        stops=first.stop_count,
        lost=round(first.lost),
        first=str(first.candidate or ""),
        is_spoilt=int(first.candidate is not None and bool(names & set(first.candidate.names))),
        second=str(second.candidate or "") if second else "",
        stops_before=fresh_stops(robot, worlds),
        stops_after=fresh_stops(both_followed, worlds),
        asked=round(answered - began, 1),
        again=round(answered_again - answered, 1),
    )


def _following(robot: Robot, candidate: Optional[Candidate]) -> Robot:
    """Return the robot with the advice followed."""
    if candidate is None:
        return robot
    return with_changes(robot, candidate.changes, robot.name)


def main() -> None:
    """Append the rows of folders that the table lacks."""
    known = [row["spoilt"] for row in begun(TABLE, FolderRow._fields)]
    for number, pair in enumerate(PAIRS):
        spoilt = [fault for fault in faults(JACKAL) if str(fault) in pair]
        if "; ".join(map(str, spoilt)) in known:
            continue
        first_world = WORLDS * number
        worlds = [JUDGING[(first_world + index) % len(JUDGING)] for index in range(WORLDS)]
        row = folder_row(spoilt, worlds)
        append(TABLE, row)
        print(row, flush=True)


if __name__ == "__main__":
    main()
