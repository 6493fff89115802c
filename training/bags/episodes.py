"""Transitions (s, theta, r, s', terminated, truncated) of the paper's MDP from the decisions in a Bag, goal by goal.

bags_to_dataset.py calls it. A decision of the applr node holds what it saw, what the planner had, and what was chosen;
the action's status, the odometry and the scans of the bag say what came of it.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.form import PaperForm
from applr_ros1.policy.observation import ObservationError, observe
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND
from training.bags.bag import Bag, BagError, Decision
from training.env.episode import CONTROL_PERIOD, TIME_LIMIT, nearest, progress
from training.env.outcome import Outcome
from training.env.reward import Reward, failed
from training.replay.trajectory import Trajectory, TransitionLayout

SUCCEEDED, ABORTED = 3, (4, 5)  # actionlib
MAX_AGE_S = 1.0  # older scans and poses say nothing about a decision
JUMP_M = 0.3  # beyond what 5 m/s covers: the robot was put elsewhere, or the clock was


class Skipped(ApplrError):
    """An episode, or a part of one, that cannot be used; the text is the reason, without numbers, to be counted."""


@dataclass
class BagReport:
    """The account of what became of a bag."""

    episodes: int = 0
    transitions: int = 0
    periods: Set[float] = field(default_factory=set)  # of its decisions [s]
    skipped: Counter[str] = field(default_factory=Counter)  # transitions that are not used, by reason


class Goal(NamedTuple):
    """One course as driven: when it began and ended, and how (actionlib status; None: the bag ended first)."""

    id: str
    start: int
    end: int
    status: Optional[int]
    frame: str
    xy: Tuple[float, float]

    @property
    def ended(self) -> bool:
        """Return whether it was reached or given up: a terminal state, unlike a goal that was cancelled or replaced."""
        return self.status == SUCCEEDED or self.status in ABORTED


@dataclass
class Sample:
    """A decision, or the end of a course, where none was made.

    Attributes:
        at: ROS time [ns].
        decision: The decision; at the end the last one.
        trouble: Why it cannot be used (outcome is None), or why the transition that ends here cannot.
        pose: (x, y) [m] of the robot in the goal's frame.
        theta: (k,) what the planner had.
    """

    at: int
    decision: Decision
    trouble: str = ""
    pose: Tuple[float, float] = (0.0, 0.0)
    theta: np.ndarray = field(default_factory=lambda: np.empty(0))
    observation: np.ndarray = field(default_factory=lambda: np.empty(0))
    outcome: Optional[Outcome] = None


def transitions(
    bag: Bag,
    robot: Robot = JACKAL,
    reward: Reward = Reward(),
    layout: TransitionLayout = TransitionLayout(),
    report: Optional[BagReport] = None,
    finish: Optional[float] = None,
) -> Iterator[Trajectory]:
    """Yield a Trajectory per usable stretch of each goal; what is unusable is counted in `report`.

    Args:
        bag: What was recorded.
        robot: Who drove.
        reward: Of each transition.
        layout: Of what is yielded.
        report: Is filled.
        finish: Metres towards the goal after which a course counts as reached, though move_base drives on (the paper's
            goal lies beyond the finish line); None: only move_base's own result counts.

    Raises:
        BagError: The bag lacks what is needed.
    """
    _check(bag)
    report = report if report is not None else BagReport()
    form, period = PaperForm(robot), decision_period(bag)
    for number, goal in enumerate(goals(bag, report.skipped)):
        try:
            _check_motion(bag, goal)
            goal = _finished(bag, goal, finish)
            samples = _samples(bag, form, goal)
        except Skipped as reason:
            report.skipped[str(reason)] += 1
            continue
        report.periods.add(period)
        for before, after in zip(samples, samples[1:]):
            if before.outcome and after.outcome:
                _label(bag, robot, goal, before, after, after.outcome)
                after.trouble = _unusable(bag, form, period, before, after, is_last=after is samples[-1])
        for run in split_at_gaps(samples, report.skipped):
            report.episodes += 1
            report.transitions += len(run) - 1
            trajectory = _trajectory(form, period, run, reward, layout)
            trajectory.info.update(actor="bag:" + bag.path.name[:180], episode=number, goal=goal.id[:180])
            yield trajectory


def _check(bag: Bag) -> None:
    """Raise BagError where a bag lacks what transitions are made of."""
    topics = bag.topics
    if not bag.decisions:
        remedy = "record a drive of the applr node with record:=FILE; ./applr tune ROBOT --bag reads bags without them"
        raise BagError(f"no decisions on {topics.decision}: {remedy}")
    for what, topic, times in (("scans", topics.scan, bag.scans.at), ("odometry", topics.odometry, bag.odometry.at)):
        if not len(times):
            raise BagError(f"no {what} on {topic}")
    if abs(np.median(bag.scans.at - bag.scans.stamp)) > SECOND:
        raise BagError("recorded on another clock than its messages'; set use_sim_time where you record")


# -- courses -----------------------------------------------------------------------------------------------------------
def goals(bag: Bag, skipped: Counter[str]) -> List[Goal]:
    """Return the goals that were pursued, by the action's status; why one cannot be used, or there is none, counts."""
    spans: List[List] = []  # [id, start, end]
    before = ""
    for at, running in bag.status:
        if before:  # it was pursued until now
            spans[-1][2] = at
        if running and running != before:
            spans.append([running, at, at])
        before = running
    found = []
    for goal, start, end in spans:
        targets = [g for g in bag.goals if start - 2 * SECOND <= g[0] <= start + SECOND]
        targets = targets or [g for g in bag.goals if g[0] <= end]
        at, status = bag.results.get(goal, (end, None))
        if targets:
            end = end if status is None else min(end, at)
            found.append(Goal(goal, start, end, status, targets[-1][1], targets[-1][2:4]))
        else:
            skipped["the goal's position was not recorded"] += 1
    if not spans:
        skipped["no goal was pursued"] += 1
    return found


def decision_period(bag: Bag) -> float:
    """Return the decision period [s]: the median interval of a goal's decisions, in whole control cycles.

    Where no goal has two of them it is the paper's.
    """
    stamps: Dict[str, List[int]] = {}
    for decision in bag.decisions:
        if 0 <= decision.stamp <= bag.end:  # a bag may state anything
            stamps.setdefault(decision.goal, []).append(decision.stamp)
    intervals = np.concatenate([np.zeros(0), *(np.diff(times) for times in stamps.values())])
    intervals = intervals[intervals > 0]
    if not len(intervals):
        return PERIOD
    return round(max(1, round(float(np.median(intervals)) / SECOND / CONTROL_PERIOD)) * CONTROL_PERIOD, 9)


def _check_motion(bag: Bag, goal: Goal) -> None:
    """Raise Skipped where the odometry says that robot or clock jumped while the goal was pursued."""
    during = (bag.odometry.stamp >= goal.start) & (bag.odometry.stamp <= goal.end)
    stamps, pose = bag.odometry.stamp[during], bag.odometry.pose[during]
    if len(stamps) < 2 or not np.isfinite(pose).all():
        raise Skipped("odometry is not finite" if len(stamps) > 1 else "no odometry while the goal was pursued")
    gaps = np.diff(stamps)
    if (gaps < 0).any() or (gaps == 0).mean() > 0.1:
        raise Skipped("the clock jumped")
    if (np.hypot(*np.diff(pose[:, :2], axis=0).T) > JUMP_M + 5.0 * gaps / SECOND).any():
        raise Skipped("the odometry jumped")
    stamps = bag.scans.stamp[(bag.scans.at >= goal.start) & (bag.scans.at <= goal.end)]
    if (np.diff(stamps) < 0).any():
        raise Skipped("the clock jumped")


def _finished(bag: Bag, goal: Goal, finish: Optional[float]) -> Goal:
    """Return the goal, which ends where the robot has got `finish` metres towards it."""
    if finish is None:
        return goal
    during = np.flatnonzero((bag.odometry.stamp >= goal.start) & (bag.odometry.stamp <= goal.end)).tolist()
    poses = np.array([_place(bag, i, goal.frame, goal.end) for i in during])
    towards = np.array(goal.xy) - poses[0]
    past = (poses - poses[0]) @ towards >= finish * np.hypot(*towards)
    if not past.any():
        return goal
    return goal._replace(end=int(bag.odometry.stamp[during[np.argmax(past)]]), status=SUCCEEDED)


# -- samples -----------------------------------------------------------------------------------------------------------
def _samples(bag: Bag, form: PaperForm, goal: Goal) -> List[Sample]:
    """Return the decisions, and the end of the course where the goal was reached or given up."""
    made = [d for d in bag.decisions if d.goal == goal.id and d.stamp <= goal.end]
    samples = [Sample(decision.stamp, decision) for decision in made]
    if made and goal.ended and goal.end > made[-1].stamp:
        samples.append(Sample(goal.end, made[-1]))
    if len(samples) < 2:
        raise Skipped("shorter than one decision" if made else "no decision was recorded for the goal")
    for number, sample in enumerate(samples):
        try:
            scan, pose = _messages(bag, sample)
            sample.pose = _place(bag, pose, goal.frame, sample.at)
            _look(form, sample)
            near = nearest(bag.scans.nearest[[scan]], form.robot.laser.range_min)
            time_s = (sample.at - samples[0].at) / SECOND
            seen = sample.observation[: form.scan], 0.0, sample.theta
            sample.outcome = Outcome(*seen, last_scan_min=near, decision_min=near, decisions=number, time_s=time_s)
        except ObservationError as error:
            sample.trouble = f"a decision's scan is unusable ({str(error).split(':')[0]})"
        except Skipped as reason:
            sample.trouble = str(reason)
    return samples


def _messages(bag: Bag, sample: Sample) -> Tuple[int, int]:
    """Return which scan and which odometry of the bag a sample is of.

    They are those that the node names; at the end of a course, and in a bag of fewer messages, the nearest.
    """
    scans, poses, decision = bag.scans.stamp, bag.odometry.stamp, sample.decision
    scan, pose = _last(scans == decision.scan), _last(poses == decision.odometry)
    if sample.at != decision.stamp or min(scan, pose) < 0:
        scan = _last(scans <= sample.at)
        pose = int(np.argmin(np.abs(poses - scans[scan])))
    for what, index, times in (("scan", scan, scans), ("odometry", pose, poses)):
        if index < 0 or abs(int(times[index]) - sample.at) > MAX_AGE_S * SECOND:
            raise Skipped(f"no {what} for a decision")
    return scan, pose


def _last(which: np.ndarray) -> int:
    """Return the last index at which `which` (n,) holds; -1 for none."""
    found = np.flatnonzero(which)
    return int(found[-1]) if len(found) else -1


def _look(form: PaperForm, sample: Sample) -> None:
    """Set parameters and observation of a sample in the paper's form.

    A policy in the dimensionless form was shown other sectors: of these the nearest in each beam is taken.
    """
    decision, seen = sample.decision, sample.decision.observation
    is_end = sample.at != decision.stamp
    sample.theta = _after(form, decision) if is_end else _theta(form, decision.before)
    sectors = len(seen) - 1 - form.actions
    if not (np.abs(seen) <= 1.0).all():
        raise Skipped("the observation of a decision is not within [-1, 1]")
    if sectors == form.scan:
        sample.observation = np.append(seen[: sectors + 1], form.action(sample.theta)).astype(np.float32)
        return
    layout = DimensionlessForm(form.robot, PERIOD).layout
    if sectors != layout.beams:
        raise Skipped("a decision was made with a scan of other beams than the robot's")
    ranges = form.layout.resample(0.5 * (seen[:sectors] + 1.0) * layout.range_cap, layout.angle_min, layout.step)
    sample.observation = observe(ranges, seen[sectors] * math.pi, sample.theta, form.space, form.layout)


def _after(form: PaperForm, decision: Decision) -> np.ndarray:
    """Return the parameters (k,) that the planner had after a decision; those before it where it was refused."""
    return _theta(form, decision.after or decision.before)


def _theta(form: PaperForm, values: Dict[str, float]) -> np.ndarray:
    """Return theta (k,) of the {name: value} of a decision."""
    theta = np.array([values.get(name, math.nan) for name in form.space.names])
    if not np.isfinite(theta).all():
        raise Skipped("the planner's parameters are not known")
    return theta


def _label(bag: Bag, robot: Robot, goal: Goal, before: Sample, after: Sample, outcome: Outcome) -> None:
    """Set the parts of an Outcome that a transition has: progress, clearance, contact, the end."""
    outcome.progress, outcome.progress_y = progress(goal.xy, before.pose, after.pose)
    outcome.seconds = (after.at - before.at) / SECOND
    during = (bag.scans.stamp > before.at) & (bag.scans.stamp <= after.at)
    if during.any():
        outcome.decision_min = nearest(bag.scans.nearest[during], robot.laser.range_min)
    outcome.contact = any(before.at < at <= after.at for at in bag.collisions)
    if goal.ended and after.at == goal.end:
        outcome.success, outcome.aborted = goal.status == SUCCEEDED, goal.status in ABORTED


def _unusable(bag: Bag, form: PaperForm, period: float, before: Sample, after: Sample, is_last: bool) -> str:
    """Return why a transition cannot be used; "" when it can."""
    seconds, stamps = (after.at - before.at) / SECOND, bag.scans.stamp
    if seconds > 1.5 * period or (seconds < 0.5 * period and not is_last):
        return "a decision's period is not that of the others"
    stamps = stamps[(stamps >= before.at - MAX_AGE_S * SECOND) & (stamps <= after.at)]
    if len(stamps) < 2 or np.diff(stamps).max() > MAX_AGE_S * SECOND:
        return "scans are missing"
    if not np.array_equal(_after(form, before.decision), after.theta):
        return "parameters were changed between decisions"
    return ""


def _place(bag: Bag, index: int, frame: str, at: int) -> Tuple[float, float]:
    """Return (x, y) of odometry number `index` in `frame`, through a recorded transform where frames differ."""
    x, y, _ = bag.odometry.pose[index].tolist()
    if not frame or frame == bag.odometry.frame:
        return x, y
    known = [t for time, t in bag.transforms.get((frame, bag.odometry.frame), ()) if time <= at]
    if not known:
        raise Skipped("no transform between the goal's frame and the odometry's")
    return transform_point(known[-1], x, y)


# -- episodes ----------------------------------------------------------------------------------------------------------
def split_at_gaps(samples: List[Sample], skipped: Counter[str]) -> Iterator[List[Sample]]:
    """Yield runs of samples with usable transitions between them; the trouble of the others counts in `skipped`."""
    run: List[Sample] = []
    for sample in samples:
        if sample.trouble:
            skipped[sample.trouble] += 1
            if len(run) > 1:
                yield run
            run = []
        if sample.outcome is not None:
            run.append(sample)
    if len(run) > 1:
        yield run


def _trajectory(
    form: PaperForm, period: float, run: List[Sample], reward: Reward, layout: TransitionLayout
) -> Trajectory:
    """Return the transitions between the samples of a run."""
    actions, rewards, outcomes = [], [], [sample.outcome for sample in run if sample.outcome]
    for before, outcome in zip(run, outcomes[1:]):
        action = form.action(_after(form, before.decision))
        change = float(np.abs(action - form.action(before.theta)).mean())
        limit = max(round(TIME_LIMIT / period), outcome.decisions)
        rewards.append(reward(outcome, change, limit, period, scale=1.0)[0])
        actions.append(action)
    last = outcomes[-1]
    info = {"from": outcomes[0].decisions, "success": bool(last.success)}
    return Trajectory.of(layout, [m.observation for m in run], actions, rewards, last.success or failed(last), info)
