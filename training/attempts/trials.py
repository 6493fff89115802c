"""Whole drives in the worlds that the laser saw: with the recorded values, and with candidates.

A candidate is believed only if it drives better from the recorded starts to the recorded goals,
with seeds that did not choose it. One recorded drive gives one course, a logbook several.
"""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from typing_extensions import override

import sim_bridge
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives import simulate
from applr_ros1.drives.drive import REACHED, TIMED_OUT, Driven
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.outcome import arrived_cleanly
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy import methods
from applr_ros1.policy.pilot import Pilot
from applr_ros1.robots import Robot
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from training.attempts.candidates import Candidate, mildest_first, with_changes
from training.attempts.verdict import clearly_worse, corrected
from training.workers.calls import CallFailed, CallLost
from training.workers.pool import Pool
from worlds import World

_LOGGER = logging.getLogger(__name__)
POLICY = "applr"  # the robot's policy
CHOOSING = 1, 2  # seeds that choose a candidate
# Seeds that judge the chosen one
CONFIRMING = range(3, 15)
# Numbers of them with which it is judged: with all if it is better with the first ones, but not
# clearly, as where a sound robot fails, too, in every other drive
LOOKS = 6, 12
RECORDED = Candidate((), "recorded values")  # what candidates are compared with
ROUND = 3  # number of candidates that drive before the best of them sets the time for others
CHOSEN = 3  # number of candidates that drive with more than one seed
JUDGED = 2  # number of candidates that are judged at most
BETTER = 0.9  # share of the time with the recorded values below which a candidate is better
# Ratio of times up to which a smaller change is preferred, and one course of several is not slower
NEARLY = 1.1
# Ratio to the best time of a seed from which on a drive is broken off; with several courses, ratio
# to the time with the recorded values, as a change need not help on every course.
BEHIND = 1.25
SLOWEST = 1.5  # longest duration of a drive in durations of the recorded one
SHORTEST_LIMIT_S = 20.0  # smallest time limit of a drive [s]
# Time limit if the recorded drive did not arrive [s], and its smallest ratio to the time of a
# straight drive at top speed
UNKNOWN_LIMIT_S = 60.0
UNKNOWN_RATIO = 3.0
SAME_PLACE_M = 1.0  # distance of two stops at the same place [m, for the Jackal]
RANDOM: Dict[str, Any] = {  # deviations of a drive from the nominal robot
    "start_xy": 0.03,
    "start_yaw": 0.05,
    "scan_noise": (1, 3),
    "odometry": (0.5, 2),
}


class DriveConditions(NamedTuple):
    """Conditions that all whole drives share.

    Attributes:
        robot: Robot with the values of the recorded drive in its files.
        world: World that the laser saw, with the recorded start and goal.
        has_monitor: Whether a collision monitor stands between planner and base.
        limit: Time after which a drive has failed [s].
        ends_at_tolerance: Whether a drive ends within the goal tolerance, or only when the planner
            reports the goal.
        policy_decides: Whether the robot's policy decides, as it did in the recorded drive.
    """

    robot: Robot
    world: World
    has_monitor: bool
    limit: float
    ends_at_tolerance: bool = True
    policy_decides: bool = False


class CourseRun(NamedTuple):
    """Drive that every candidate may have: the number of its course, and its seed."""

    course: int
    seed: int


class Arrival(NamedTuple):
    """How one whole drive ended.

    Attributes:
        success: Whether the robot arrived without a contact.
        seconds: Time to the goal [s]; the limit if the drive failed.
        is_slow: Whether the drive was broken off, because it was not faster than with the recorded
            values, or much slower than with another candidate.
        path: (k, 3) time [s] and position (x, y) [m] in the odometry frame of the recorded drive.
    """

    success: bool
    seconds: float
    is_slow: bool
    path: np.ndarray


class DrivenCourse(NamedTuple):
    """Course on which whole drives are made.

    Attributes:
        robot: Robot with the values of the recorded drive in its files.
        policy_decides: Whether the robot's policy decides, as it did in the recorded drive.
        begin: Begins a drive, given changed values, the seed and the time to beat [s], and returns
            what waits for its end.
    """

    robot: Robot
    policy_decides: bool
    begin: Callable[[Sequence[Change], int, float], Callable[[], Arrival]]


class Tried(NamedTuple):
    """A candidate that was driven.

    Attributes:
        candidate: The candidate, or RECORDED.
        drives: Its drives, for each seed one on each course.
    """

    candidate: Candidate
    drives: Sequence[Arrival]

    @property
    def arrivals(self) -> int:
        """Number of drives that arrived."""
        return sum(drive.success for drive in self.drives)

    @property
    def seconds(self) -> float:
        """Mean time [s]. A failed drive counts the limit."""
        return float(_seconds(self.drives).mean())

    def on_course(self, number: int, course_count: int) -> Tried:
        """Return the drives on one of several courses."""
        return self._replace(drives=self.drives[number::course_count])

    @override
    def __str__(self) -> str:
        arrived = [drive.seconds for drive in self.drives if drive.success]
        slow_count = sum(drive.is_slow for drive in self.drives)
        if slow_count:
            return f"too slow in {slow_count} of {len(self.drives)}"
        result_in_words = f"arrives {len(arrived)} of {len(self.drives)}"
        if arrived:
            result_in_words += f" in {np.mean(arrived):.0f} s"
        return result_in_words


class WholeDriveTrials(NamedTuple):
    """Result of all whole drives.

    Attributes:
        recorded: Drives with the recorded values, of the seeds that judge.
        remedy: The candidate that is better with the seeds that judge, or None.
        tried: All candidates with the seeds that chose, the best first.
        judged: Candidates with the seeds that judge, the remedy last.
        policy_decided: Whether the robot's policy decided in all of them.
        course_count: Number of courses.
    """

    recorded: Tried
    remedy: Optional[Tried]
    tried: Sequence[Tried]
    judged: Sequence[Tried] = ()
    policy_decided: bool = False
    course_count: int = 1

    def on_course(self, number: int) -> WholeDriveTrials:
        """Return the drives on one of the courses."""

        def there(tried: Tried) -> Tried:
            return tried.on_course(number, self.course_count)

        return self._replace(
            recorded=there(self.recorded),
            remedy=there(self.remedy) if self.remedy else None,
            tried=list(map(there, self.tried)),
            judged=list(map(there, self.judged)),
            course_count=1,
        )


def limit_of(seconds: float, straight_seconds: float) -> float:
    """Return the time limit of whole drives [s].

    Args:
        seconds: Duration of the recorded way to the goal [s]; inf if the drive did not arrive.
        straight_seconds: Time of a straight drive from start to goal at top speed [s].
    """
    if np.isfinite(seconds):
        return max(SLOWEST * seconds, SHORTEST_LIMIT_S)
    return max(UNKNOWN_RATIO * straight_seconds, UNKNOWN_LIMIT_S)


def drive_once(
    conditions: DriveConditions, changes: Sequence[Change], seed: int, to_beat: float
) -> Arrival:
    """Drive a course with changed values, at most for the time to beat [s].

    Raises ApplrError for values that move_base refuses.
    """
    robot = conditions.robot
    if changes:
        robot = with_changes(robot, changes, robot.name)
    limit = min(conditions.limit, float(np.ceil(to_beat)))
    move_base = MoveBase(robot.driven_parameters(), planner=CPP_LIKE, seed=seed)
    has_monitor = conditions.has_monitor
    stack = Stack(robot, move_base, monitor=has_monitor, escapes=has_monitor)
    simulator = sim_bridge.make("kinematic", robot=robot, **RANDOM)
    rules = Rules(
        end_on_contact=True,
        ends_at_tolerance=conditions.ends_at_tolerance,
        limit=limit,
    )
    pilot = None
    if conditions.policy_decides:
        policy = methods.make(POLICY, robot)
        pilot = Pilot(policy, robot)
    # Without a pilot the values in the files stay, even outside the ranges of robot.yaml.
    simulated = SimulatedRobot(simulator, stack)
    driven = simulate.drive(simulated, conditions.world, seed, pilot, rules=rules)
    truth = driven.require(Driven).truth
    goal = driven.goals[-1]
    success = bool(arrived_cleanly(goal.status == REACHED, len(driven.contacts)))
    is_timeout = goal.status == TIMED_OUT
    # Paths are sent between processes.
    path = np.column_stack([truth.time, truth.pose[:, :2]]).astype(np.float32)
    return Arrival(
        success=success,
        seconds=goal.end if success else conditions.limit,
        is_slow=is_timeout and limit < conditions.limit,
        path=path,
    )


def course_in(conditions: DriveConditions, pool: Pool) -> DrivenCourse:
    """Return the course of some conditions, on which the workers of a pool drive."""

    def begin(changes: Sequence[Change], seed: int, to_beat: float) -> Callable[[], Arrival]:
        return pool.submit(drive_once, conditions, changes, seed, to_beat).result

    return DrivenCourse(conditions.robot, conditions.policy_decides, begin)


def drive_recorded(courses: Sequence[DrivenCourse]) -> Tried:
    """Drive with the recorded values, with the seeds that choose, on all courses."""
    return Tried(RECORDED, _drive(courses, [RECORDED], _runs(courses, CHOOSING))[RECORDED])


def try_out(courses: Sequence[DrivenCourse], candidates: Sequence[Candidate]) -> WholeDriveTrials:
    """Drive with the recorded values and with candidates, each on all courses.

    All candidates drive once, the best ones with more seeds, and the best of these are judged with
    seeds that chose nothing, one after the other until one is a remedy. A drive that is not faster
    than with the recorded values, or much slower than with another candidate, is broken off.
    """
    is_single = len(courses) == 1
    choosing_runs = _runs(courses, CHOOSING)
    recorded = drive_recorded(courses)
    to_beat = {}
    for run, arrival in zip(choosing_runs, recorded.drives):
        to_beat[run] = arrival.seconds if is_single else BEHIND * arrival.seconds

    # All candidates drive once, in rounds, because the best of a round shortens the next one.
    drives: Drives = {}
    first_runs = _runs(courses, CHOOSING[:1])
    for group_begin in range(0, len(candidates), ROUND):
        candidate_group = candidates[group_begin : group_begin + ROUND]
        drives.update(_drive(courses, candidate_group, first_runs, to_beat))
        # On several courses, the best one may be another candidate on each.
        if is_single:
            for (arrival,) in drives.values():
                (run,) = first_runs
                to_beat[run] = min(to_beat[run], BEHIND * arrival.seconds)

    # The best ones drive with the other seeds.
    best_candidates = _ranked(drives)[:CHOSEN]
    later_runs = _runs(courses, CHOOSING[1:])
    for candidate, arrivals in _drive(courses, best_candidates, later_runs, to_beat).items():
        drives[candidate] += arrivals
    tried = [Tried(candidate, drives[candidate]) for candidate in _ranked(drives)]
    finalists = []
    for entry in tried:
        if len(entry.drives) == len(choosing_runs) and _is_better(entry, recorded):
            finalists.append(entry)

    # The best of several looks better than it is, so that other seeds judge it.
    confirming: Drives = defaultdict(list)

    def confirmed(candidate: Candidate, seed_count: int) -> Tried:
        """Return drives of a candidate with some of the seeds that judge, none driven twice."""
        runs = _runs(courses, CONFIRMING[:seed_count])
        drives = confirming[candidate]
        drives += _drive(courses, [candidate], runs[len(drives) :])[candidate]
        return Tried(candidate, drives[: len(runs)])

    judged = []
    remedy = None
    for candidate in _preferred(finalists, courses[0].robot)[:JUDGED]:
        for seed_count in LOOKS:
            recorded = confirmed(RECORDED, seed_count)
            entry = confirmed(candidate, seed_count)
            if not _helps(entry, recorded, len(courses)):
                break
            # One lucky drive can make a mean better by a tenth.
            level = corrected(len(LOOKS))
            if clearly_worse(_seconds(recorded.drives), _seconds(entry.drives), level):
                remedy = entry
                break
        judged.append(entry)
        if remedy:
            break
    policy_decided = any(course.policy_decides for course in courses)
    return WholeDriveTrials(recorded, remedy, tried, judged, policy_decided, len(courses))


Drives = Dict[Candidate, List[Arrival]]


def _runs(courses: Sequence[DrivenCourse], seeds: Sequence[int]) -> List[CourseRun]:
    """Return the drives of each candidate: all courses with the first seed, then with the next."""
    runs = []
    for seed in seeds:
        for number in range(len(courses)):
            runs.append(CourseRun(number, seed))
    return runs


def _drive(
    courses: Sequence[DrivenCourse],
    candidates: Sequence[Candidate],
    runs: Sequence[CourseRun],
    to_beat: Mapping[CourseRun, float] = {},
) -> Drives:
    """Return the drives of candidates. A candidate that move_base refuses is left out.

    Args:
        courses: Where they drive.
        candidates: Candidates, or RECORDED.
        runs: Drives of each.
        to_beat: Time [s] by run after which a drive is broken off.
    """
    # All calls first, so that the workers are busy while the results are collected.
    drives_begun = []
    for candidate in candidates:
        for run in runs:
            limit = to_beat.get(run, math.inf)
            begun = courses[run.course].begin(candidate.changes, run.seed, limit)
            drives_begun.append((candidate, begun))
    drives: Drives = {candidate: [] for candidate in candidates}
    for candidate, arrival_of in drives_begun:
        try:
            arrival = arrival_of()
        except CallFailed as failure:
            # Values may contradict each other, such as a footprint without an area.
            if candidate == RECORDED:
                problem = "the recorded values cannot be driven in simulation"
                raise ApplrError(f"{problem}: {failure}") from None
            drives.pop(candidate, None)
            reason = "its worker died" if isinstance(failure, CallLost) else "move_base refuses it"
            _LOGGER.info("%s: left out, %s", candidate, reason)
        else:
            _LOGGER.info("%s: %s", candidate, Tried(candidate, [arrival]))
            if candidate in drives:
                drives[candidate].append(arrival)
    return drives


def _ranked(drives: Drives) -> List[Candidate]:
    """Return candidates: those with most drives first, among them those with the least time."""

    def key(candidate: Candidate) -> Tuple[int, float]:
        return -len(drives[candidate]), Tried(candidate, drives[candidate]).seconds

    return sorted(drives, key=key)


def _preferred(finalists: Sequence[Tried], robot: Robot) -> List[Candidate]:
    """Return candidates in the order in which they are judged.

    Among those that drive about as fast as the first one, the mildest come first: the usual value
    of a parameter that hinders says more than what makes up for it.
    """
    mildness = mildest_first(robot)

    def key(tried: Tried) -> Tuple[bool, Tuple[float, float]]:
        return tried.seconds > NEARLY * finalists[0].seconds, mildness(tried.candidate)

    return [tried.candidate for tried in sorted(finalists, key=key)]


def _helps(tried: Tried, recorded: Tried, course_count: int) -> bool:
    """Return whether a candidate is better on all courses together, and on none worse.

    Args:
        tried: Drives of the candidate with the seeds that judge.
        recorded: Drives with the recorded values, of the same seeds.
        course_count: Number of courses.
    """
    if not _is_better(tried, recorded):
        return False
    for number in range(course_count):
        there = tried.on_course(number, course_count)
        if _is_worse(there, recorded.on_course(number, course_count)):
            return False
    return True


def _is_better(tried: Tried, recorded: Tried) -> bool:
    """Return whether a candidate arrives at least as often, in a tenth less time."""
    return tried.arrivals >= recorded.arrivals and tried.seconds <= BETTER * recorded.seconds


def _is_worse(tried: Tried, recorded: Tried) -> bool:
    """Return whether drives on a course arrive less often, or clearly later, than recorded ones."""
    return tried.arrivals < recorded.arrivals or tried.seconds > NEARLY * recorded.seconds


def _seconds(drives: Sequence[Arrival]) -> np.ndarray:
    """Return the times of drives (n,) [s]."""
    return np.array([drive.seconds for drive in drives])
