"""Logbook: the stops of many bags, their places, and the change that would help most."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Sequence, Tuple

import numpy as np

from applr_ros1.common.files import sha256
from applr_ros1.why.answer import Answer
from applr_ros1.why.events import Event
from training.bags.read import BagError
from training.why.bag_answer import AnsweredBag, answer_to
from training.why.logged_bag import LoggedBag, bag_hash, key_of_answers
from training.why.recorded import BagAnswerOptions
from training.workers.calls import CallFailed
from training.workers.pool import Pool

DATED_S = 946_684_800.0  # 2000: an earlier clock is that of a simulation [s]
OVERLAP = 0.5  # share of the shorter of two stops from which on both are one stop in two bags
# Median distance of the places of two simulated drives at the same times up to which they are one
# [m]. Places between those of a track may differ by a centimetre.
ONE_DRIVE_M = 0.02
SHORTEST_S = 5.0  # time in both bags below which nothing is known [s]
CELL_M = 0.2  # edge of the cells by which odometry frames are compared [m]
ALIKE = 0.5  # share of the cells in the part that both drives saw from which on their frames agree
FEWEST_CELLS = 30  # number of cells in that part below which nothing is known

# Shows the progress of a loop, given its items, the number of all items and of those done before.
ProgressBar = Callable[[Iterable[Any], int, int], Iterable[Any]]


@dataclass(frozen=True)
class LoggedStop:
    """Stop of a logbook.

    Attributes:
        bag: Its bag.
        stop: What happened.
    """

    bag: LoggedBag
    stop: Event

    @property
    def begin(self) -> float:
        """Begin [s, by the clock of the bag]."""
        return self.bag.answer.begin + self.stop.begin

    @property
    def end(self) -> float:
        """End [s, by the clock of the bag]."""
        return self.bag.answer.begin + self.stop.end

    @property
    def is_dated(self) -> bool:
        """True if the bag's clock is that of the day, not of a simulation."""
        return self.begin >= DATED_S

    @property
    def position(self) -> Tuple[float, float]:
        """Place x, y [m] in the frame of its floor."""
        ((x, y),) = self.bag.answer.placed([self.stop.place]).tolist()
        return x, y


@dataclass
class Logbook:
    """Stops of many bags.

    Attributes:
        bags: Bags that were read.
        stops: Stops, the one that cost most time first.
        places: Stops at each place, the place that cost most time first. Those at one place are
            within a robot's length of its first one, which cost most time.
        notes: Sentences about bags that were left out, and about what is not kept.
    """

    bags: List[LoggedBag]
    stops: List[LoggedStop]
    places: List[List[LoggedStop]]
    notes: List[str]

    @property
    def lost(self) -> float:
        """Time that all stops cost [s]."""
        return lost_in(self.stops)

    @property
    def commands(self) -> int:
        """Number of recorded commands of all replayed drives."""
        return sum(bag.answer.commands for bag in self.bags)

    @property
    def reproduced(self) -> int:
        """Number of those that the replays reproduce."""
        return sum(bag.answer.reproduced for bag in self.bags)

    @property
    def robots(self) -> Dict[str, float]:
        """Time lost by robot [s], the largest one first."""
        lost_by_robot: Dict[str, float] = {bag.answer.robot: 0.0 for bag in self.bags}
        for logged in self.stops:
            lost_by_robot[logged.bag.answer.robot] += logged.stop.lost
        return dict(sorted(lost_by_robot.items(), key=lambda row: -row[1]))


def lost_in(stops: Iterable[LoggedStop]) -> float:
    """Return the time that stops cost [s]."""
    return sum(logged.stop.lost for logged in stops)


def logbook_of(
    bag_paths: Sequence[Path], options: BagAnswerOptions, pool: Pool, progress: ProgressBar
) -> Logbook:
    """Return the logbook of bags. Answers that are kept beside the bags are not made again.

    Args:
        bag_paths: The bags.
        options: Robot and topics of bags that do not describe them.
        pool: Workers that read and replay.
        progress: Shows the progress over the bags.

    Raises:
        BagError: No bag can be read.
    """
    notes: List[str] = []
    all_bags = _distinct_bags(bag_paths, options, notes)
    problems = _answer(all_bags, options, pool, progress)
    # In the order of the files, whichever was answered first
    bags = [bag for bag in all_bags if bag.is_answered]
    if not bags:
        raise BagError(f"no bag can be read: {problems[0]}" if problems else "there are no bags")
    notes += problems
    notes += _notes_of_files(all_bags)
    set_floors(bags)
    stops = stops_of(bags)
    stop_count = sum(len(bag.answer.events) for bag in bags)
    if len(stops) < stop_count:
        notes.append(f"{stop_count - len(stops)} stops are in two bags: they are counted once")
    logbook = Logbook(bags, stops, places_of(stops), notes)
    notes += notes_of_robots(logbook)
    return logbook


def notes_of_robots(logbook: Logbook) -> List[str]:
    """Return what is to be said of bags of several robots, of which one gets advice."""
    lost_by_robot = logbook.robots
    if len(lost_by_robot) < 2:
        return []
    listed = ", ".join(f"{name} ({lost:.0f} s)" for name, lost in lost_by_robot.items())
    first_robot = next(iter(lost_by_robot))
    return [
        f"bags of several robots, {listed}: a change is sought for {first_robot}; "
        "give the bags of another one alone"
    ]


# -- bags ------------------------------------------------------------------------------------------
def _distinct_bags(
    bag_paths: Sequence[Path], options: BagAnswerOptions, notes: List[str]
) -> List[LoggedBag]:
    """Return bags with the answers that are kept, each bag once, and add notes about copies."""
    key = key_of_answers(options)
    first_paths: Dict[str, Path] = {}
    bags = []
    for bag_path in bag_paths:
        try:
            bag_key = bag_hash(bag_path)
        except OSError:
            # Whoever reads it says what is wrong.
            bag_key = str(bag_path)
        if bag_key in first_paths:
            notes.append(f"{bag_path}: left out, the same as {first_paths[bag_key]}")
            continue
        first_paths[bag_key] = bag_path
        bags.append(LoggedBag(bag_path, sha256(key, bag_key)))
    return bags


def _answer(
    bags: Sequence[LoggedBag], options: BagAnswerOptions, pool: Pool, progress: ProgressBar
) -> List[str]:
    """Answer to the bags that have no answer yet, and return what is wrong with the others."""
    problems: Dict[Path, str] = {}
    bag_at = {bag.path: bag for bag in bags}
    unanswered = [bag.path for bag in bags if not bag.is_answered]
    calls = pool.unordered(partial(answer_to, options=options), unanswered)
    for bag_path, call in progress(calls, len(bags), len(bags) - len(unanswered)):
        try:
            answered: AnsweredBag = call.result()
        except CallFailed as failure:
            problem = str(failure)
            problems[bag_path] = problem if str(bag_path) in problem else f"{bag_path}: {problem}"
            continue
        bag_at[bag_path].keep(answered.answer)
        bag_at[bag_path].conditions = answered.conditions
    return [problems[bag.path] for bag in bags if bag.path in problems]


def _notes_of_files(bags: Sequence[LoggedBag]) -> List[str]:
    """Return what is to be said of the files beside the bags."""
    notes = []
    damaged = [bag for bag in bags if bag.is_damaged]
    if damaged:
        notes.append(f"{len(damaged)} answers beside their bags were damaged: made again")
    unkept = [bag for bag in bags if bag.problem]
    if unkept:
        notes.append(f"answers are not kept: {unkept[0].problem}")
    return notes


# -- stops and places ------------------------------------------------------------------------------
def stops_of(bags: Sequence[LoggedBag]) -> List[LoggedStop]:
    """Return the stops of bags, the one that cost most time first.

    A black box keeps the last minutes at each stop, so that two bags may have the same one.
    """
    all_stops = []
    for bag in bags:
        for stop in bag.answer.events:
            all_stops.append(LoggedStop(bag, stop))
    all_stops.sort(key=lambda logged: -logged.stop.lost)
    distinct_stops: List[LoggedStop] = []
    for logged in all_stops:
        if not any(_is_same(logged, other) for other in distinct_stops):
            distinct_stops.append(logged)
    return distinct_stops


def _is_same(stop: LoggedStop, other: LoggedStop) -> bool:
    """Return whether two stops of different bags are the same one."""
    if stop.bag is other.bag or stop.bag.answer.robot != other.bag.answer.robot:
        return False
    overlap = min(stop.end, other.end) - max(stop.begin, other.begin)
    if overlap <= OVERLAP * min(stop.end - stop.begin, other.end - other.begin):
        return False
    if stop.is_dated and other.is_dated:
        return _is_one_place(stop, other)
    # Simulated drives begin at the same time, and often at the same place.
    return _is_one_drive(stop.bag.answer, other.bag.answer)


def _is_one_place(stop: LoggedStop, other: LoggedStop) -> bool:
    """Return whether two stops of robots of one name are at one place, of one robot then."""
    if stop.bag.answer.frame != other.bag.answer.frame:
        return False
    distance = math.dist(stop.position, other.position)
    return distance <= stop.bag.answer.length


def _is_one_drive(answer: Answer, other: Answer) -> bool:
    """Return whether two bags have the same drive, as far as both have it."""
    track = np.array(answer.track)
    other_track = np.array(other.track)
    times = answer.begin + track[:, 0]
    other_times = other.begin + other_track[:, 0]
    if min(times[-1], other_times[-1]) - max(times[0], other_times[0]) < SHORTEST_S:
        return False
    in_both = (times >= other_times[0]) & (times <= other_times[-1])
    x, y = answer.placed(track[in_both, 1:3]).T
    other_x, other_y = other.placed(other_track[:, 1:3]).T
    apart_x = x - np.interp(times[in_both], other_times, other_x)
    apart_y = y - np.interp(times[in_both], other_times, other_y)
    return bool(np.median(np.hypot(apart_x, apart_y)) <= ONE_DRIVE_M)


def places_of(stops: Sequence[LoggedStop]) -> List[List[LoggedStop]]:
    """Return the stops at each place, the place that cost most time first.

    Stops within a robot's length of the worst one there are at one place.

    Args:
        stops: The stops, the worst first.
    """
    places: List[List[LoggedStop]] = []
    for logged in stops:
        for place in places:
            worst_stop = place[0]
            is_near = math.dist(worst_stop.position, logged.position) <= logged.bag.answer.length
            if is_near and worst_stop.bag.floor == logged.bag.floor:
                place.append(logged)
                break
        else:
            places.append([logged])
    return sorted(places, key=lost_in, reverse=True)


# -- frames ----------------------------------------------------------------------------------------
def set_floors(bags: Sequence[LoggedBag]) -> None:
    """Give bags in one frame the same floor.

    A map's frame is shared by its name. Odometry begins anew at each start of a robot: two of its
    frames are one only if the laser saw the same there.
    """
    cells_of_bags = [_cells(bag.answer) for bag in bags]
    floor_count = 0
    for number, bag in enumerate(bags):
        bag.floor = floor_count
        for earlier_number, earlier in enumerate(bags[:number]):
            is_known = bag.answer.frame == earlier.answer.frame
            is_known &= bag.answer.is_shared == earlier.answer.is_shared
            if is_known and not bag.answer.is_shared:
                is_known = _agree(cells_of_bags[number], cells_of_bags[earlier_number])
            if is_known:
                bag.floor = earlier.floor
                break
        if bag.floor == floor_count:
            floor_count += 1


def _cells(answer: Answer) -> np.ndarray:
    """Return the cells (n, 2) in which the laser saw something."""
    cells: np.ndarray = np.unique(np.floor(answer.placed(answer.map) / CELL_M).astype(int), axis=0)
    return cells


def _agree(cells: np.ndarray, others: np.ndarray) -> bool:
    """Return whether two drives saw the same in the part of the plane that both saw."""
    if not len(cells) or not len(others):
        return False
    lowest = np.maximum(cells.min(axis=0), others.min(axis=0))
    highest = np.minimum(cells.max(axis=0), others.max(axis=0))
    parts = []
    for drive_cells in (cells, others):
        is_inside = (drive_cells >= lowest).all(axis=1) & (drive_cells <= highest).all(axis=1)
        parts.append(set(map(tuple, drive_cells[is_inside].tolist())))
    smaller, larger = sorted(parts, key=len)
    if len(smaller) < FEWEST_CELLS:
        return False
    return len(smaller & larger) >= ALIKE * len(smaller)
