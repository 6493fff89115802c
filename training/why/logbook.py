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
# Distance of the places of two drives at the same times up to which they are one [m], most of the
# time. Places between those of a track may differ by a centimetre.
ONE_DRIVE_M = 0.02
MOST_OF_TIME = 0.9
MOVED_M = 0.2  # way from which on a track is one of its own [m]
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
    unkept = [bag for bag in all_bags if bag.problem]
    if unkept:
        notes.append(f"answers are not kept: {unkept[0].problem}")
    set_floors(bags)
    stops = stops_of(bags)
    stop_count = sum(len(bag.answer.events) for bag in bags)
    if len(stops) < stop_count:
        double_count = stop_count - len(stops)
        stops_are = "stop is" if double_count == 1 else "stops are"
        notes.append(f"{double_count} {stops_are} in two bags: counted once")
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
    return _is_one_drive(stop.bag.answer, other.bag.answer)


def _is_one_drive(answer: Answer, other: Answer) -> bool:
    """Return whether two bags have the same drive, as far as both have it.

    Robots of one name may stand at the same time, each where its own odometry began: then what the
    laser saw must be the same, too.
    """
    track = np.reshape(answer.track, (-1, 4))
    other_track = np.reshape(other.track, (-1, 4))
    # By the clock of the first one
    other_times, other_x, other_y, _ = other_track.T
    other_times = other_times + other.begin - answer.begin
    is_after_begin = track[:, 0] >= other_times.min(initial=np.inf)
    is_before_end = track[:, 0] <= other_times.max(initial=-np.inf)
    times, x, y, _ = track[is_after_begin & is_before_end].T
    if not len(times) or np.ptp(times) < SHORTEST_S:
        return False
    apart_x = x - np.interp(times, other_times, other_x)
    apart_y = y - np.interp(times, other_times, other_y)
    if np.quantile(np.hypot(apart_x, apart_y), MOST_OF_TIME) > ONE_DRIVE_M:
        return False
    has_moved = math.hypot(np.ptp(x), np.ptp(y)) > MOVED_M
    return has_moved or _alike(_cells(answer), _cells(other)) == 1


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

    Maps of two floors may have one name, and odometry begins anew at each start of
    a robot. Two frames are one if the laser saw the same there, and those of a map also if nothing
    speaks against it.
    """
    floors: List[List[LoggedBag]] = []
    cells_of = {id(bag): _cells(bag.answer) for bag in bags}
    for bag in bags:
        likeness_of: Dict[int, int] = {}
        for number, floor in enumerate(floors):
            answer = floor[0].answer
            if (answer.frame, answer.is_shared) == (bag.answer.frame, bag.answer.is_shared):
                likenesses = [_alike(cells_of[id(bag)], cells_of[id(other)]) for other in floor]
                if min(likenesses) >= 0:
                    likeness_of[number] = max(likenesses)
        bag.floor = max(likeness_of, key=likeness_of.__getitem__, default=len(floors))
        if not (likeness_of.get(bag.floor) or (likeness_of and bag.answer.is_shared)):
            bag.floor = len(floors)
            floors.append([])
        floors[bag.floor].append(bag)


def _cells(answer: Answer) -> np.ndarray:
    """Return the cells (n, 2) in which the laser saw something."""
    cells: np.ndarray = np.unique(np.floor(answer.placed(answer.map) / CELL_M).astype(int), axis=0)
    return cells


def _alike(cells: np.ndarray, others: np.ndarray) -> int:
    """Return 1 if two drives saw the same in the part of the plane that both saw, -1 if not.

    0 if too little is there to compare. Cells beside each other are the same: a drive is placed in
    a map as well as it was localised.
    """
    from scipy.spatial import KDTree  # slow, and needed only here

    if not len(cells) or not len(others):
        return 0
    lowest = np.maximum(cells.min(axis=0), others.min(axis=0))
    highest = np.minimum(cells.max(axis=0), others.max(axis=0))
    parts = []
    for drive_cells in (cells, others):
        is_inside = (drive_cells >= lowest).all(axis=1) & (drive_cells <= highest).all(axis=1)
        parts.append(drive_cells[is_inside])
    smaller, larger = sorted(parts, key=len)
    if len(smaller) < FEWEST_CELLS:
        return 0
    cells_apart, _ = KDTree(larger).query(smaller, p=np.inf)
    return 1 if (cells_apart <= 1).mean() >= ALIKE else -1
