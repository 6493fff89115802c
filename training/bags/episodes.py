"""Transitions (s, theta, r, s', terminated, truncated) of the paper's MDP from the decisions in a Bag, goal by goal.

bags_to_dataset.py calls it. A decision of the applr node holds what it saw, what the planner had, and what was chosen;
the action's status, the odometry and the scans of the bag say what came of it.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Optional, Set, Tuple

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.form import PaperForm
from applr_ros1.policy.observation import ObservationError, observe
from applr_ros1.robots import JACKAL, Robot
from training.bags.bag import SECOND, Bag, BagError, Decision
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


@dataclass
class Goal:
    """One course as driven: when it began and ended, and how (actionlib status; None: the bag ended first)."""

    id: str
    start: int
    end: int
    status: Optional[int]
    frame: str
    xy: Tuple[float, float]
    period: float  # between two decisions [s]

    @property
    def ended(self) -> bool:
        """Reached or given up: a terminal state. A goal that was cancelled or replaced is merely cut off."""
        return self.status == SUCCEEDED or self.status in ABORTED


@dataclass
class Sample:
    """A decision, or the end of a course, where none was made.

    Attributes:
        at: ROS time [ns].
        decision: The decision; at the end the last one.
        is_end: The course ends here.
        trouble: Why it cannot be used (outcome is None), or why the transition that ends here cannot.
    """

    at: int
    decision: Decision
    is_end: bool = False
    scan: int = -1  # indices in the bag
    pose: int = -1
    trouble: str = ""
    theta: Optional[np.ndarray] = None
    observation: Optional[np.ndarray] = None
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
    if not bag.decisions:
        remedy = "record a drive of the applr node with record:=FILE; ./applr tune ROBOT --bag reads bags without them"
        raise BagError(f"{bag.path}: no decisions on {bag.topics.decision}: {remedy}")
    for what, topic, times in (
        ("scans", bag.topics.scan, bag.scans.at),
        ("odometry", bag.topics.odometry, bag.odometry.at),
    ):
        if not len(times):
            raise BagError(f"{bag.path}: no {what} on {topic}")
    if abs(np.median(bag.scans.at - bag.scans.stamp)) > SECOND:
        raise BagError(f"{bag.path}: recorded on another clock than its messages'; set use_sim_time where you record")
    report = report if report is not None else BagReport()
    form = PaperForm(robot)
    for number, goal in enumerate(goals(bag, report.skipped)):
        try:
            _check_motion(bag, goal)
            _finish(bag, goal, finish)
            samples = _samples(bag, goal)
        except Skipped as reason:
            report.skipped[str(reason)] += 1
            continue
        report.periods.add(goal.period)
        for i, sample in enumerate(samples):
            if sample.trouble:
                continue
            try:
                _look(bag, form, samples, i)
                if i and samples[i - 1].outcome is not None:
                    _label(bag, robot, goal, samples[i - 1], sample)
                    sample.trouble = _unusable(bag, form, goal, samples, i)
            except ObservationError as error:
                sample.outcome, sample.trouble = None, f"a decision's scan is unusable ({str(error).split(':')[0]})"
            except Skipped as reason:
                sample.outcome, sample.trouble = None, str(reason)
        for run in split_at_gaps(samples, report.skipped):
            yield _trajectory(bag, form, goal, number, run, reward, layout, report)


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
    found, period = [], decision_period(bag)
    for goal, start, end in spans:
        targets = [g for g in bag.goals if start - 2 * SECOND <= g[0] <= start + SECOND]
        targets = targets or [g for g in bag.goals if g[0] <= end]
        at, status = bag.results.get(goal, (end, None))
        if targets:
            end = end if status is None else min(end, at)
            found.append(Goal(goal, start, end, status, targets[-1][1], targets[-1][2:4], period))
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
    """Raises Skipped where the odometry says that robot or clock jumped while the goal was pursued."""
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


def _finish(bag: Bag, goal: Goal, finish: Optional[float]) -> None:
    """Ends the course where the robot has got `finish` metres towards the goal."""
    if finish is None:
        return
    during = np.flatnonzero((bag.odometry.stamp >= goal.start) & (bag.odometry.stamp <= goal.end)).tolist()
    poses = np.array([_pose(bag, i, goal.frame, goal.end)[:2] for i in during])
    towards = np.array(goal.xy) - poses[0]
    past = (poses - poses[0]) @ towards >= finish * np.hypot(*towards)
    if past.any():
        goal.end, goal.status = int(bag.odometry.stamp[during[np.argmax(past)]]), SUCCEEDED


def _samples(bag: Bag, goal: Goal) -> List[Sample]:
    """The decisions, and the end of the course where the goal was reached or given up."""
    made = [d for d in bag.decisions if d.goal == goal.id and d.stamp <= goal.end]
    samples = [Sample(decision.stamp, decision) for decision in made]
    if made and goal.ended and goal.end > made[-1].stamp:
        samples.append(Sample(goal.end, made[-1], is_end=True))
    if len(samples) < 2:
        raise Skipped("shorter than one decision" if made else "no decision was recorded for the goal")
    scans, stamps = bag.scans, bag.odometry.stamp
    for one in samples:
        named = [] if one.is_end else [_last(scans.stamp == one.decision.scan), _last(stamps == one.decision.odometry)]
        if min(named, default=-1) < 0:  # at the end, or in a bag of fewer messages than the node got
            scan = _last(scans.stamp <= one.at)
            named = [scan, int(np.argmin(np.abs(stamps - scans.stamp[scan])))]
        one.scan, one.pose = named
        for what, index, times in (("scan", one.scan, scans.stamp), ("odometry", one.pose, stamps)):
            if index < 0 or abs(int(times[index]) - one.at) > MAX_AGE_S * SECOND:
                one.trouble = f"no {what} for a decision"
    return samples


def _last(which: np.ndarray) -> int:
    """The last index at which `which` (n,) holds; -1 for none."""
    found = np.flatnonzero(which)
    return int(found[-1]) if len(found) else -1


# -- samples -----------------------------------------------------------------------------------------------------------
def _look(bag: Bag, form: PaperForm, samples: List[Sample], i: int) -> None:
    """Fills sample i with what was seen at it. Raises Skipped or ObservationError where that cannot be used."""
    sample, decision, beams = samples[i], samples[i].decision, form.layout.beams
    sample.theta = _after(form, decision) if sample.is_end else _theta(form, decision.before)
    seen = decision.observation
    if not (np.abs(seen) <= 1.0).all():
        raise Skipped("the observation of a decision is not within [-1, 1]")
    sectors = len(seen) - 1 - form.actions
    if sectors != beams:
        seen = _in_the_papers_form(seen, form, sectors, sample.theta)
    sample.observation = np.concatenate([seen[: beams + 1], form.action(sample.theta)]).astype(np.float32)
    near = nearest(bag.scans.nearest[[sample.scan]], form.robot.laser.range_min)
    seconds = (sample.at - samples[0].at) / SECOND
    sample.outcome = Outcome(
        seen[:beams], 0.0, sample.theta, last_scan_min=near, decision_min=near, decisions=i, time_s=seconds
    )


def _in_the_papers_form(seen: np.ndarray, form: PaperForm, sectors: int, theta: np.ndarray) -> np.ndarray:
    """What a policy in the dimensionless form was shown, as the paper's form has it: the nearest of its sectors."""
    layout = DimensionlessForm(form.robot, PERIOD).layout
    if sectors != layout.beams:
        raise Skipped("a decision was made with a scan of other beams than the robot's")
    ranges = form.layout.resample(0.5 * (seen[:sectors] + 1.0) * layout.range_cap, layout.angle_min, layout.step)
    return observe(ranges, seen[sectors] * math.pi, theta, form.space, form.layout)


def _after(form: PaperForm, decision: Decision) -> np.ndarray:
    """The parameters (k,) that the planner had after a decision; those before it where it was refused."""
    return _theta(form, decision.after or decision.before)


def _theta(form: PaperForm, values: Dict[str, float]) -> np.ndarray:
    """{name: value} of a decision → theta (k,)."""
    theta = np.array([values.get(name, math.nan) for name in form.space.names])
    if not np.isfinite(theta).all():
        raise Skipped("the planner's parameters are not known")
    return theta


def _label(bag: Bag, robot: Robot, goal: Goal, before: Sample, sample: Sample) -> None:
    """Fills the parts of an Outcome that a transition has: progress, clearance, contact, the end."""
    outcome = sample.outcome
    assert outcome is not None
    here = _pose(bag, sample.pose, goal.frame, sample.at)
    there = _pose(bag, before.pose, goal.frame, before.at)
    outcome.progress, outcome.progress_y = progress(goal.xy, there, here)
    outcome.seconds = (sample.at - before.at) / SECOND
    during = (bag.scans.stamp > before.at) & (bag.scans.stamp <= sample.at)
    if during.any():
        outcome.decision_min = nearest(bag.scans.nearest[during], robot.laser.range_min)
    outcome.contact = any(before.at < at <= sample.at for at in bag.collisions)
    if goal.ended and sample.at == goal.end:
        outcome.success, outcome.aborted = goal.status == SUCCEEDED, goal.status in ABORTED


def _unusable(bag: Bag, form: PaperForm, goal: Goal, samples: List[Sample], i: int) -> str:
    """Why the transition that ends at sample i cannot be used; "" when it can."""
    before, after = samples[i - 1], samples[i]
    seconds, is_last = (after.at - before.at) / SECOND, i == len(samples) - 1
    if seconds > 1.5 * goal.period or (seconds < 0.5 * goal.period and not is_last):
        return "a decision's period is not that of the others"
    stamps = bag.scans.stamp[(bag.scans.stamp >= before.at - MAX_AGE_S * SECOND) & (bag.scans.stamp <= after.at)]
    if len(stamps) < 2 or np.diff(stamps).max() > MAX_AGE_S * SECOND:
        return "scans are missing"
    assert after.theta is not None
    if not np.array_equal(_after(form, before.decision), after.theta):
        return "parameters were changed between decisions"
    return ""


def _pose(bag: Bag, index: int, frame: str, at: int) -> Tuple[float, float, float]:
    """Odometry number `index` as (x, y, yaw) in `frame`, through a recorded transform where frames differ."""
    x, y, a = bag.odometry.pose[index].tolist()
    if not frame or frame == bag.odometry.frame:
        return x, y, a
    known = [t for time, t in bag.transforms.get((frame, bag.odometry.frame), ()) if time <= at]
    if not known:
        raise Skipped("no transform between the goal's frame and the odometry's")
    return (*transform_point(known[-1], x, y), a + known[-1][2])


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


def _trajectory(bag, form, goal, number, run, reward, layout, report) -> Trajectory:
    actions, rewards = [], []
    for before, after in zip(run, run[1:]):
        action = form.action(_after(form, before.decision))
        change = float(np.abs(action - form.action(before.theta)).mean())
        limit = max(round(TIME_LIMIT / goal.period), after.outcome.decisions)
        rewards.append(reward(after.outcome, change, limit, goal.period, scale=1.0)[0])
        actions.append(action)
    last = run[-1].outcome
    report.episodes += 1
    report.transitions += len(rewards)
    info = {
        "actor": "bag:" + bag.path.name[:180],
        "episode": number,
        "goal": goal.id[:180],
        "from": run[0].outcome.decisions,
        "success": bool(last.success),
    }
    return Trajectory.of(layout, [m.observation for m in run], actions, rewards, last.success or failed(last), info)
