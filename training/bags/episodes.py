"""Conversion of the decisions in a Bag to transitions (s, theta, r, s', terminated, truncated), goal by goal.

bags_to_dataset.py calls transitions(). A recorded decision contains the method's parameters and the raw inputs. Any
encoding makes the same observation from these inputs as in the node and in the learning environment. The outcome
follows from the action's status, the odometry and the scans.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Dict, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.dimensionless import ENCODINGS
from applr_ros1.policy.encoding import PAPER, Encoding
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND
from training.bags.bag import Bag, BagError, Decision
from training.env.episode import CONTROL_PERIOD, TIME_LIMIT
from training.env.outcome import Outcome, nearest, progress
from training.env.reward import Reward, failed
from training.replay.trajectory import Trajectory, TransitionLayout

SUCCEEDED, ABORTED = 3, (4, 5)  # status codes of actionlib
MAX_AGE_S = 1.0  # age above which a scan or pose is not used for a decision [s]
JUMP_M = 0.3  # movement between two poses that counts as a jump, in addition to 5 m/s times the interval [m]


class Skipped(ApplrError):
    """Error of an unusable episode. The message is the reason without numbers, so that reasons can be counted."""


class Goal(NamedTuple):
    """Goal pursued by move_base: id, times of start and end [ns], actionlib status (None if the bag ended first)."""

    id: str
    start: int
    end: int
    status: Optional[int]

    @property
    def ended(self) -> bool:
        """Return whether the goal ended in a terminal state: reached or aborted, but not cancelled or replaced."""
        return self.status == SUCCEEDED or self.status in ABORTED


@dataclass
class Sample:
    """Decision, or end of a course.

    Attributes:
        decision: The decision; at the end of a course, the observation there instead.
        place: (x, y) [m] of the robot in the decision's frame.
        is_end: Whether the course ended or was interrupted here.
        theta: (k,) current parameters after the decision.
        observation: Observation on which the decision is based.
        outcome: Outcome of the previous decision.
    """

    decision: Decision
    place: Tuple[float, float]
    is_end: bool
    theta: np.ndarray
    observation: np.ndarray
    outcome: Outcome

    @property
    def at(self) -> int:
        """ROS time of the decision [ns]."""
        return self.decision.stamp


def transitions(
    bag: Bag, robot: Robot = JACKAL, observation: str = PAPER, reward: Reward = Reward(), finish: Optional[float] = None
) -> Tuple[List[Trajectory], Counter[str]]:
    """Return a Trajectory for each usable part of the drive to each goal, and the numbers of unusable parts by reason.

    Args:
        bag: Content of the bag.
        robot: Robot that drove.
        observation: Name of the encoding of the transitions.
        reward: Reward of a transition.
        finish: Distance towards the goal [m] after which a course counts as finished although move_base drives on (the
            paper's goal lies beyond the finish line). None: only the result of move_base counts.

    Raises:
        BagError: The bag lacks required data.
    """
    encoding = ENCODINGS[observation](robot, decision_period(bag))
    _check(bag, encoding)
    trajectories: List[Trajectory] = []
    skipped: Counter[str] = Counter()
    for goal in goals(bag):
        try:
            _check_motion(bag, goal)
            samples = _samples(bag, encoding, goal, finish)
        except Skipped as reason:
            skipped[str(reason)] += 1
            continue
        trajectories += [_trajectory(encoding, run, reward) for run in _usable(bag, encoding, samples, skipped)]
    return trajectories, skipped


def _check(bag: Bag, encoding: Encoding) -> None:
    """Raise BagError if a bag lacks data for transitions of this encoding."""
    topics = bag.topics
    if not bag.decisions:
        raise BagError(f"no decisions on {topics.decision}: record a drive of the applr node with record:=FILE")
    for what, topic, rows in (
        ("scans", topics.scan, bag.scans.at),
        ("odometry", topics.odometry, bag.odometry.stamp),
        ("goals", topics.move_base + "/status", goals(bag)),
    ):
        if not len(rows):
            raise BagError(f"no {what} on {topic}")
    if abs(np.median(bag.scans.at - bag.scans.stamp)) > SECOND:
        raise BagError("recorded with another clock than that of its messages: set use_sim_time in the recorder")
    theirs = list(bag.decisions[0].before)
    if set(theirs) != set(encoding.space.names):
        raise BagError(f"its decisions set {', '.join(theirs)}: give the --robot with these parameters")


# -- courses -----------------------------------------------------------------------------------------------------------
def goals(bag: Bag) -> List[Goal]:
    """Return the goals that move_base pursued, according to the status of its action."""
    pursued: List[Goal] = []
    before = ""
    for at, running in bag.status:
        if before:  # The goal was pursued until now.
            pursued[-1] = pursued[-1]._replace(end=at)
        if running and running != before:
            pursued.append(Goal(running, at, at, None))
        before = running
    ends = [(goal, *bag.results.get(goal.id, (goal.end, None))) for goal in pursued]
    return [goal._replace(end=min(goal.end, at), status=status) for goal, at, status in ends]


def decision_period(bag: Bag) -> float:
    """Return the decision period [s]: the median interval between a goal's decisions, in whole control cycles.

    Return the paper's period if no goal has two decisions.
    """
    stamps: Dict[str, List[int]] = {}
    for decision in bag.decisions:
        stamps.setdefault(decision.goal, []).append(decision.stamp)
    intervals = np.concatenate([np.zeros(0), *(np.diff(times) for times in stamps.values())])
    if not len(intervals):
        return PERIOD
    return round(max(1, round(float(np.median(intervals)) / SECOND / CONTROL_PERIOD)) * CONTROL_PERIOD, 9)


def _check_motion(bag: Bag, goal: Goal) -> None:
    """Raise Skipped if the odometry jumped while the goal was pursued, as after a jump of the clock."""
    during = (bag.odometry.stamp >= goal.start) & (bag.odometry.stamp <= goal.end)
    stamps, pose = bag.odometry.stamp[during], bag.odometry.pose[during]
    if len(stamps) < 2:
        raise Skipped("no odometry while the goal was pursued")
    gaps = np.diff(stamps)
    if (np.hypot(*np.diff(pose[:, :2], axis=0).T) > JUMP_M + 5.0 * gaps / SECOND).any():
        raise Skipped("the odometry jumped")


# -- samples -----------------------------------------------------------------------------------------------------------
def _samples(bag: Bag, encoding: Encoding, goal: Goal, finish: Optional[float]) -> List[Sample]:
    """Return samples of a goal's decisions, and of the points at which its course ended or was interrupted.

    The node publishes its observation a moment after an end. If this message is missing, a goal that was reached or
    aborted ends with the observation of the last decision, because the value of a terminal state is not used.
    """
    made = [d for d in bag.decisions if d.goal == goal.id and d.stamp <= goal.end]
    if not made:
        raise Skipped("no decision was recorded for the goal")
    ends = [d for d in bag.ends if d.goal == goal.id and d.stamp <= goal.end + MAX_AGE_S * SECOND]
    if finish is not None:
        goal = _finished(bag, goal, made, finish)
        made, ends = ([d for d in some if d.stamp <= goal.end] for some in (made, ends))
    moments = [(d, d.seen.pose[:2], False) for d in made]
    moments += [(d._replace(stamp=min(d.stamp, goal.end)), d.seen.pose[:2], True) for d in ends]
    moments.sort(key=lambda moment: moment[0].stamp)
    last, _, is_recorded = moments[-1]
    if goal.ended and made[-1].stamp < goal.end and not (is_recorded and last.stamp > goal.end - MAX_AGE_S * SECOND):
        end = made[-1]._replace(stamp=goal.end, before=made[-1].after or made[-1].before)
        moments.append((end, tuple(_driven(bag, made[-1], goal.end)[1][-1]), True))
    if len(moments) < 2:
        raise Skipped("shorter than one decision")
    samples: List[Sample] = []
    encoding.reset()
    for number, (decision, place, is_end) in enumerate(moments):
        had, has = (_theta(encoding, values) for values in (decision.before, decision.after or decision.before))
        seen = encoding.observe(Context.of(had, decision.seen, encoding.space, encoding.layout))
        outcome = Outcome(had, decisions=number, time_s=(decision.stamp - moments[0][0].stamp) / SECOND)
        samples.append(Sample(decision, place, is_end, has, seen, outcome))
        if number:
            _label(bag, encoding.robot, *samples[-2:])
        if is_end:
            encoding.reset()
    if is_end and goal.ended:
        outcome.success, outcome.aborted = goal.status == SUCCEEDED, goal.status in ABORTED
    return samples


def _finished(bag: Bag, goal: Goal, made: List[Decision], finish: float) -> Goal:
    """Return the goal, which ends as reached once the robot has driven `finish` [m] towards it."""
    begin = np.array(made[0].seen.pose[:2])
    for decision, until in zip(made, [*(d.stamp for d in made[1:]), goal.end]):
        stamps, places = _driven(bag, decision, until)
        towards = np.array(decision.seen.goal[:2]) - begin
        past = (places - begin) @ towards >= finish * np.hypot(*towards)
        if past.any():
            return goal._replace(end=int(stamps[np.argmax(past)]), status=SUCCEEDED)
    return goal


def _driven(bag: Bag, decision: Decision, until: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [ns] and positions (n, 2) [m] of the robot after a decision, in the decision's frame.

    The positions begin with the pose in the decision, which is for the time of its scan, and continue by odometry.
    """
    stamps = bag.odometry.stamp
    first = int(np.argmin(np.abs(stamps - decision.scan)))
    rows = np.append(first, np.flatnonzero((stamps > stamps[first]) & (stamps <= until)))
    change = compose(decision.seen.pose, inverse(tuple(bag.odometry.pose[first].tolist())))
    return stamps[rows], np.column_stack(transform_point(change, *bag.odometry.pose[rows, :2].T))


def _theta(encoding: Encoding, values: Dict[str, float]) -> np.ndarray:
    """Return theta (k,) from a decision's parameters {name: value}."""
    return np.array([values[name] for name in encoding.space.names])


def _label(bag: Bag, robot: Robot, before: Sample, after: Sample) -> None:
    """Set progress, clearance, contact and time in the outcome of a transition."""
    outcome = after.outcome
    outcome.progress, outcome.progress_y = progress(before.decision.seen.goal, before.place, after.place)
    outcome.seconds = (after.at - before.at) / SECOND
    ranges = bag.scans.nearest[(bag.scans.stamp >= before.at) & (bag.scans.stamp <= after.at)]
    if len(ranges):
        lowest = robot.laser.range_min
        outcome.decision_min, outcome.last_scan_min = nearest(ranges, lowest), nearest(ranges[-1:], lowest)
    outcome.contact = any(before.at < at <= after.at for at in bag.collisions)


def _unusable(bag: Bag, encoding: Encoding, before: Sample, after: Sample) -> str:
    """Return why a transition cannot be used, or "" if it can."""
    seconds, stamps = (after.at - before.at) / SECOND, bag.scans.stamp
    early = seconds < 0.5 * encoding.period and not after.outcome.over
    if early and after.is_end:
        return "a course was interrupted soon after a decision"
    if early or seconds > 1.5 * encoding.period:
        return "a decision's period differs from the others"
    stamps = stamps[(stamps >= before.at - MAX_AGE_S * SECOND) & (stamps <= after.at)]
    if len(stamps) < 2 or np.diff(stamps).max() > MAX_AGE_S * SECOND:
        return "scans are missing"
    if not np.array_equal(before.theta, after.outcome.theta):
        return "parameters were changed between decisions"
    return ""


# -- episodes ----------------------------------------------------------------------------------------------------------
def _usable(bag: Bag, encoding: Encoding, samples: List[Sample], skipped: Counter[str]) -> Iterator[List[Sample]]:
    """Yield runs of samples with usable transitions between them. Count the other transitions in `skipped`."""
    run = samples[:1]
    for before, after in zip(samples, samples[1:]):
        reason = "" if before.is_end else _unusable(bag, encoding, before, after)
        if reason:
            skipped[reason] += 1
        if reason or before.is_end:
            if len(run) > 1:
                yield run
            run = []
        run.append(after)
    if len(run) > 1:
        yield run


def _trajectory(encoding: Encoding, run: List[Sample], reward: Reward) -> Trajectory:
    """Return the transitions between the samples of a run."""
    actions, rewards, outcome = [], [], run[0].outcome
    for before, after in zip(run, run[1:]):
        actions.append(encoding.action(before.theta))
        outcome = after.outcome
        limit = max(round(TIME_LIMIT / encoding.period), outcome.decisions)
        rewards.append(reward(outcome, limit, encoding.period, encoding)[0])
    observations, terminated = [sample.observation for sample in run], outcome.success or failed(outcome)
    return Trajectory.of(TransitionLayout.of(encoding), observations, actions, rewards, terminated)
