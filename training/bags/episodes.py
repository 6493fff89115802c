"""Rebuilds the transitions (s, theta, r, s', terminated, truncated) of the paper's MDP from a Recording, goal by goal.

bags_to_dataset.py calls it. Two kinds of bags are read. Where the applr node's decisions were recorded they say which
messages a decision saw and what the planner had; each observation is rebuilt from these very messages and compared with
the node's. Elsewhere the servers' parameter_updates say what the planner had, and decisions are taken to fall every two
seconds from a goal's first plan on.
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
from applr_ros1.policy.observation import ObservationError, goal_angle, local_goal, observe
from training.bags.reader import SECOND, Recording
from training.env.episode import CONTROL_PERIOD, TIME_LIMIT, nearest, progress
from training.env.outcome import Outcome
from training.env.reward import Reward, failed
from training.replay.trajectory import Trajectory, TransitionLayout

SUCCEEDED, ABORTED = 3, (4, 5)  # actionlib
MAX_AGE = 1.0  # s; older scans, poses and plans are no basis for a decision
JUMP = 0.3  # m beyond what 5 m/s covers: the robot was put elsewhere, or the clock was
EARLIER = SECOND // 4  # an update that was recorded within this time of a decision is its result
CLOSE = 1e-5  # difference at which a rebuilt observation still equals the node's (float32, pose rounding)


class Skipped(ApplrError):
    """An episode, or a part of one, that cannot be used; the text is the reason, without numbers, to be counted."""


@dataclass
class BagReport:
    """What became of a bag."""

    episodes: int = 0
    transitions: int = 0
    verified: int = 0  # observations equal to the node's own
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
class RebuiltObservation:
    """An observation to be rebuilt from messages, and what came of it.

    Attributes:
        at: ROS time [ns].
        decision: what the node published, if it made and recorded one.
        end: the course ends here, and no decision was made.
        scan, pose, plan: indices of the messages that the observation is made of; -1 for none.
        same: whether these are the messages that the node saw; else the nearest ones that were recorded.
        trouble: why it cannot be rebuilt (outcome is None), or why the transition that ends here cannot be used.
    """

    at: int
    decision: Optional[dict] = None
    end: bool = False
    scan: int = -1
    pose: int = -1
    plan: int = -1
    same: bool = False
    trouble: str = ""
    outcome: Optional[Outcome] = None
    observation: Optional[np.ndarray] = None


def trajectories(
    recording: Recording,
    reward: Reward = Reward(),
    layout: TransitionLayout = TransitionLayout(),
    report: Optional[BagReport] = None,
    finish: Optional[float] = None,
) -> Iterator[Trajectory]:
    """Yields a Trajectory per usable stretch of each goal; what is unusable is counted in `report`.

    finish: metres towards the goal after which a course counts as reached, though move_base drives on (the paper's
    goal lies beyond the finish line); None: only move_base's own result counts.
    """
    report = report if report is not None else BagReport()
    courses = []
    for goal in goals(recording, report.skipped):
        try:
            _check_motion(recording, goal)
            _finish(recording, goal, finish)
            courses.append((goal, _samples(recording, goal)))
            report.periods.add(goal.period)
        except Skipped as reason:
            report.skipped[str(reason)] += 1
    scans = recording.scans(m.scan for _, samples in courses for m in samples if not m.trouble)
    for number, (goal, samples) in enumerate(courses):
        for i, sample in enumerate(samples):
            if sample.trouble:
                continue
            try:
                rebuild_observation(recording, goal, samples, i, scans[sample.scan])
                if _equals_the_nodes(recording, sample, scans[sample.scan]):
                    report.verified += 1
                if i and samples[i - 1].outcome is not None:
                    label_outcome(recording, goal, samples[i - 1], sample)
                    sample.trouble = _unusable(recording, goal, samples, i)
            except ObservationError as error:
                sample.outcome, sample.trouble = None, f"a scan or plan is unusable ({str(error).split(':')[0]})"
            except Skipped as reason:
                sample.outcome, sample.trouble = None, str(reason)
        for run in split_at_gaps(samples, report.skipped):
            yield _trajectory(recording, goal, number, run, reward, layout, report)


# -- courses -----------------------------------------------------------------------------------------------------------
def goals(recording: Recording, skipped: Counter[str]) -> List[Goal]:
    """The goals that were pursued, by the action's status; where one cannot be used, or is none, the reason counts."""
    spans: List[List] = []  # [id, start, end]
    before = ""
    for at, running in recording.status:
        if before:  # it was pursued until now
            spans[-1][2] = at
        if running and running != before:
            spans.append([running, at, at])
        before = running
    found, period = [], decision_period(recording)
    for goal, start, end in spans:
        targets = [g for g in recording.goals if start - 2 * SECOND <= g[0] <= start + SECOND]
        targets = targets or [g for g in recording.goals if g[0] <= end]
        at, status = recording.results.get(goal, (end, None))
        if targets:
            end = end if status is None else min(end, at)
            found.append(Goal(goal, start, end, status, targets[-1][1], targets[-1][2:4], period))
        else:
            skipped["the goal's position was not recorded"] += 1
    if not spans:
        skipped["no goal was pursued"] += 1
    return found


def decision_period(recording: Recording) -> float:
    """The decision period [s]: the median interval of a goal's recorded decisions, in whole control cycles.

    Where none were recorded it is the paper's.
    """
    stamps: Dict[str, List[int]] = {}
    for decision in recording.decisions:
        if 0 <= decision["stamp"] <= recording.end:  # a bag may state anything
            stamps.setdefault(decision["goal"], []).append(decision["stamp"])
    intervals = np.concatenate([np.zeros(0), *(np.diff(times) for times in stamps.values())])
    intervals = intervals[intervals > 0]
    if not len(intervals):
        return PERIOD
    return round(max(1, round(float(np.median(intervals)) / SECOND / CONTROL_PERIOD)) * CONTROL_PERIOD, 9)


def _check_motion(recording, goal) -> None:
    """Raises Skipped where the odometry says that robot or clock jumped while the goal was pursued."""
    during = (recording.odometry.stamp >= goal.start) & (recording.odometry.stamp <= goal.end)
    stamps, pose = recording.odometry.stamp[during], recording.odometry.pose[during]
    if len(stamps) < 2 or not np.isfinite(pose).all():
        raise Skipped("odometry is not finite" if len(stamps) > 1 else "no odometry while the goal was pursued")
    gaps = np.diff(stamps)
    if (gaps < 0).any() or (gaps == 0).mean() > 0.1:
        raise Skipped("the clock jumped")
    if (np.hypot(*np.diff(pose[:, :2], axis=0).T) > JUMP + 5.0 * gaps / SECOND).any():
        raise Skipped("the odometry jumped")
    stamps = recording.scan_stamp[(recording.scan_at >= goal.start) & (recording.scan_at <= goal.end)]
    if (np.diff(stamps) < 0).any():
        raise Skipped("the clock jumped")


def _finish(recording, goal, finish: Optional[float]) -> None:
    """Ends the course where the robot has got `finish` metres towards the goal."""
    if finish is None:
        return
    during = np.flatnonzero((recording.odometry.stamp >= goal.start) & (recording.odometry.stamp <= goal.end))
    poses = np.array([_pose(recording, i, goal.frame, goal.end)[:2] for i in during])
    towards = np.array(goal.xy) - poses[0]
    past = (poses - poses[0]) @ towards >= finish * np.hypot(*towards)
    if past.any():
        goal.end, goal.status = int(recording.odometry.stamp[during[np.argmax(past)]]), SUCCEEDED


def _samples(recording, goal) -> List[RebuiltObservation]:
    """The samples at which decisions were made, and the end of the course.

    The course ends where the goal was reached or given up, or, if it was cut off by a time limit, a whole period after
    the last decision.
    """
    made = [d for d in recording.decisions if d["goal"] == goal.id and d["stamp"] <= goal.end]
    if made:
        samples = [_sample(recording, goal, d["stamp"], d) for d in made]
    else:
        plans = recording.plan_at[(recording.plan_at >= goal.start) & (recording.plan_at <= goal.end)]
        if not len(plans):
            raise Skipped("no global plan was recorded for the goal")
        times = range(int(plans[0]), goal.end + 1, round(goal.period * SECOND))
        samples = [_sample(recording, goal, at) for at in times]
    if goal.end - samples[-1].at > (0 if goal.ended else 0.9 * goal.period * SECOND):
        samples.append(_sample(recording, goal, goal.end))
        samples[-1].end = True
    if len(samples) < 2:
        raise Skipped("shorter than one decision")
    return samples


def _sample(recording, goal, at, decision=None) -> RebuiltObservation:
    sample, odometry = RebuiltObservation(at, decision), recording.odometry.stamp
    if decision:
        sample.scan = _last(recording.scan_stamp == decision["scan"])
        sample.pose = _last(odometry == decision["odometry"])
        sample.plan = _last(recording.plan_stamp == decision["plan"])
        sample.same = min(sample.scan, sample.pose, sample.plan) >= 0
    if not sample.same:  # no decision was recorded, or a bag of fewer messages than the node got
        sample.scan = _last(recording.scan_stamp <= at)
        sample.pose = int(np.argmin(np.abs(odometry - recording.scan_stamp[sample.scan])))
        sample.plan = _last(recording.plan_at <= at)
    for what, index, stamps in (("scan", sample.scan, recording.scan_stamp), ("odometry", sample.pose, odometry)):
        if index < 0 or abs(int(stamps[index]) - at) > MAX_AGE * SECOND:
            sample.trouble = f"no {what} for a decision"
    if sample.plan < 0 or recording.plan_at[sample.plan] < goal.start - SECOND // 2:
        sample.trouble = "no global plan for a decision"
    return sample


def _last(which) -> int:
    """The last index at which `which` (n,) holds; -1 for none."""
    found = np.flatnonzero(which)
    return int(found[-1]) if len(found) else -1


# -- samples -----------------------------------------------------------------------------------------------------------
def rebuild_observation(recording, goal, samples, i, scan) -> None:
    """Fills sample i with what was seen at it; Skipped or ObservationError where it cannot be rebuilt."""
    sample, layout, laser = samples[i], recording.layout, recording.robot.laser
    ranges, phi = _look(recording, sample, scan, layout)
    at_end = sample.end and i
    theta = theta_after(recording, goal, samples[i - 1], sample) if at_end else theta_before(recording, sample)
    sample.observation = observe(ranges, phi, theta, recording.space, layout)
    near = nearest(recording.nearest[[sample.scan]], laser.range_min)
    seconds = (sample.at - samples[0].at) / SECOND
    sample.outcome = Outcome(ranges, phi, theta, last_scan_min=near, decision_min=near, decisions=i, time_s=seconds)


def _look(recording, sample, scan, layout) -> Tuple[np.ndarray, float]:
    """Ranges (beams,) [m] of a scan as a layout has them, and the angle of the local goal [rad]."""
    frame, points = recording.plans[sample.plan]
    pose = _pose(recording, sample.pose, frame, sample.at)
    first = scan.angle_min + recording.robot.laser.pose[2]
    ranges = layout.resample(scan.ranges, first, scan.angle_increment)
    return ranges, goal_angle(local_goal(points, pose, layout.lookahead))


def theta_before(recording, sample) -> np.ndarray:
    """The parameters theta_{t-1} (k,) that the planner had when a decision was made."""
    if sample.decision:
        return _whole(recording, sample.decision["before"])
    return _announced(recording, sample.at, EARLIER)


def theta_after(recording, goal, before, after) -> np.ndarray:
    """theta_t (k,): what the planner had between two samples. It arrives within half a period or not at all."""
    if before.decision:
        return _whole(recording, before.decision["after"] or before.decision["before"])
    return _announced(recording, min(before.at + round(0.5 * goal.period * SECOND), after.at))


def _whole(recording, values) -> np.ndarray:
    """{name: value} of a decision → theta (k,)."""
    theta = np.array([values.get(name, math.nan) for name in recording.space.names])
    if not np.isfinite(theta).all():
        raise Skipped("the planner's parameters are not known")
    return theta


def _announced(recording, at, lag=0) -> np.ndarray:
    """(k,) what the servers had announced `lag` before a time, or else first until then. Inflation: the local one's.

    A server that announced nothing in the whole bag has what the robot's files say.
    """
    theta = np.array(recording.space.theta0)
    for i, name in enumerate(recording.space.names):
        target = recording.space.targets[name][0]
        if target.server not in recording.parameters:
            continue
        updates = [(time, values) for time, values in recording.parameters.get(target.server, ()) if time <= at]
        if not updates:
            raise Skipped("the planner's parameters are not known")
        values = ([values for time, values in updates if time <= at - lag] or [updates[0][1]])[-1]
        theta[i] = next(values[n] for n in target.names if n in values)
    if not np.isfinite(theta).all():
        raise Skipped("parameters are not finite")
    return theta


def _equals_the_nodes(recording, sample, scan) -> bool:
    """Whether the node's own observation was recorded and is the rebuilt one; Skipped where it is another.

    A policy in another form than the paper's sees the scan in that form's layout.
    """
    if not sample.same or not len(sample.decision["observation"]):
        return False
    seen, rebuilt = sample.decision["observation"], sample.observation
    layout = DimensionlessForm(recording.robot, PERIOD).layout
    if len(seen) - len(rebuilt) == layout.beams - recording.layout.beams:
        theta = sample.outcome.theta
        rebuilt = observe(*_look(recording, sample, scan, layout), theta, recording.space, layout)
    if seen.shape != rebuilt.shape or not np.allclose(seen, rebuilt, rtol=0.0, atol=CLOSE):
        raise Skipped("a rebuilt observation differs from the node's")
    return True


def label_outcome(recording, goal, before, sample) -> None:
    """The parts of an Outcome that a transition has: progress, clearance, contact, the end."""
    outcome = sample.outcome
    here = _pose(recording, sample.pose, goal.frame, sample.at)
    there = _pose(recording, before.pose, goal.frame, before.at)
    outcome.progress, outcome.progress_y = progress(goal.xy, there, here)
    outcome.seconds = (sample.at - before.at) / SECOND
    during = (recording.scan_stamp > before.at) & (recording.scan_stamp <= sample.at)
    if during.any():
        outcome.decision_min = nearest(recording.nearest[during], recording.robot.laser.range_min)
    outcome.contact = any(before.at < at <= sample.at for at in recording.collisions)
    if goal.ended and sample.at == goal.end:
        outcome.success, outcome.aborted = goal.status == SUCCEEDED, goal.status in ABORTED


def _unusable(recording, goal, samples, i) -> str:
    """Why the transition that ends at sample i cannot be used; "" when it can."""
    before, after = samples[i - 1], samples[i]
    seconds, last = (after.at - before.at) / SECOND, i == len(samples) - 1
    if seconds > 1.5 * goal.period or (seconds < 0.5 * goal.period and not last):
        return "a decision's period is not that of the others"
    stamps = recording.scan_stamp[
        (recording.scan_stamp >= before.at - MAX_AGE * SECOND) & (recording.scan_stamp <= after.at)
    ]
    if len(stamps) < 2 or np.diff(stamps).max() > MAX_AGE * SECOND:
        return "scans are missing"
    if not np.array_equal(theta_after(recording, goal, before, after), after.outcome.theta):
        return "parameters were changed between decisions"
    return ""


def _pose(recording, index, frame, at) -> Tuple[float, float, float]:
    """Odometry number `index` as (x, y, yaw) in `frame`, through a recorded transform where frames differ."""
    x, y, a = recording.odometry.pose[index].tolist()
    if not frame or frame == recording.odometry.frame:
        return x, y, a
    known = [t for time, t in recording.transforms.get((frame, recording.odometry.frame), ()) if time <= at]
    if not known:
        raise Skipped("no transform between the plan's frame and the odometry's")
    return (*transform_point(known[-1], x, y), a + known[-1][2])


# -- episodes ----------------------------------------------------------------------------------------------------------
def split_at_gaps(samples, skipped: Counter[str]) -> Iterator[List[RebuiltObservation]]:
    """Runs of samples with usable transitions between them; the trouble of the others counts in `skipped`."""
    run: List[RebuiltObservation] = []
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


def _trajectory(recording, goal, number, run, reward, layout, report) -> Trajectory:
    actions, rewards, form = [], [], PaperForm(recording.robot)
    for before, after in zip(run, run[1:]):
        action = form.action(theta_after(recording, goal, before, after))
        change = float(np.abs(action - form.action(before.outcome.theta)).mean())
        limit = max(round(TIME_LIMIT / goal.period), after.outcome.decisions)
        rewards.append(reward(after.outcome, change, limit, goal.period, scale=1.0)[0])
        actions.append(action)
    last = run[-1].outcome
    report.episodes += 1
    report.transitions += len(rewards)
    info = {
        "actor": "bag:" + recording.path.name[:180],
        "episode": number,
        "goal": goal.id[:180],
        "from": run[0].outcome.decisions,
        "success": bool(last.success),
    }
    return Trajectory.of(layout, [m.observation for m in run], actions, rewards, last.success or failed(last), info)
