"""Rebuilds the transitions (s, theta, r, s', terminated, truncated) of the paper's MDP from a Recording, goal by goal.

bags_to_dataset.py calls it. Where the bag holds the applr node's decisions, its observation is rebuilt from the very
messages that the node saw, and compared; otherwise a decision is taken to fall every two seconds from a goal's first plan.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Optional, Tuple

import numpy as np

from applr_ros1.policy.observation import ObservationError, check_scan, goal_angle, local_goal, observe
from applr_ros1.policy.parameter_space import SPACE, SpaceError
from training.bags import SECOND, Recording
from training.episode import LIMIT, NEAREST, PERIOD, Outcome
from training.reward import Reward, failed
from training.trajectory import Layout, Trajectory

MAX_AGE = 1.0           # s; older scans, poses and plans are no basis for a decision
JUMP = 0.3              # m beyond what 5 m/s covers: the robot was put elsewhere, or the clock was
SUCCEEDED, ABORTED = 3, (4, 5)
CLOSE = 1e-5            # difference at which a rebuilt observation still equals the node's (float32, pose rounding)


class Skipped(ValueError):
    """An episode, or a part of one, that cannot be used; the text is the reason, without numbers, to be counted."""


@dataclass
class Goal:
    """One course as driven: when it began and ended, and how (actionlib status; None: the bag ended first)."""
    id: str
    start: int
    end: int
    status: Optional[int]
    frame: str
    xy: Tuple[float, float]


@dataclass
class Report:
    """What became of a bag."""
    episodes: int = 0
    transitions: int = 0
    verified: int = 0           # observations equal to the node's own
    skipped: Dict[str, int] = field(default_factory=dict)

    def skip(self, reason: str) -> None:
        self.skipped[reason] = self.skipped.get(reason, 0) + 1


@dataclass
class Moment:
    """One observation to be rebuilt: ROS time [ns], and the indices of the messages that it is made of."""
    at: int
    scan: int
    pose: tuple
    plan: int
    number: Optional[int] = None


def trajectories(recording: Recording, reward: Reward = Reward(), layout: Layout = Layout(),
                 report: Optional[Report] = None) -> Iterator[Trajectory]:
    """Yields a Trajectory per usable stretch of each goal; what is unusable is counted in `report`."""
    report = report if report is not None else Report()
    for number, goal in enumerate(goals(recording, report)):
        try:
            yield from _rebuild(recording, goal, number, reward, layout, report)
        except Skipped as reason:
            report.skip(str(reason))


def goals(recording: Recording, report: Report) -> List[Goal]:
    """The goals that were pursued, from the action's status (or, where that was not recorded, goal and result)."""
    spans: List[List] = []
    if recording.status:
        for at, running in recording.status:
            if spans and spans[-1][3] and spans[-1][0] == running:
                spans[-1][2] = at
            else:
                if spans and spans[-1][3]:
                    spans[-1][2:] = [at, False]
                if running:
                    spans.append([running, at, at, True])
    else:
        for at, goal in recording.sent:
            if spans and spans[-1][3]:
                spans[-1][2:] = [at, False]
            spans.append([goal, at, recording.results.get(goal, (recording.end, 0))[0], False])
    found = []
    for goal, start, end, _ in spans:
        targets = [g for g in recording.goals if g[0] <= start + SECOND and g[0] >= start - 2 * SECOND] or \
            [g for g in recording.goals if g[0] <= end]
        at, status = recording.results.get(goal, (end, None))
        if not targets:
            report.skip("the goal's position was not recorded")
            continue
        found.append(Goal(goal, start, min(end, at) if status is not None else end, status, *targets[-1][1:2],
                          targets[-1][2:]))
    if not found and not report.skipped:
        report.skip("no goal was pursued")
    return found


def _rebuild(recording, goal, number, reward, layout, report) -> Iterator[Trajectory]:
    _check_motion(recording, goal)
    moments = _moments(recording, goal)
    nearest, scans = recording.scans({m.scan for m in moments})
    plans = recording.plans({m.plan for m in moments})
    outcomes, observations, reasons = [], [], []
    for i, moment in enumerate(moments):
        outcome = _outcome(recording, goal, moments, i, scans, plans, nearest)
        outcomes.append(outcome)
        obs = observe(scans[moment.scan].ranges, outcome.phi, outcome.theta)
        _compare(recording, moment, obs, report)
        observations.append(obs)
        reasons.append(_unusable(recording, moments, i))
    yield from _cut(goal, number, moments, outcomes, observations, reasons, recording, reward, layout, report)


def _moments(recording, goal) -> List[Moment]:
    """When decisions fell, with the messages of each; the last one is the episode's end."""
    made = [d for d in recording.decisions if d["goal"] == goal.id]
    if made:
        moments = [_moment(recording, goal, d["stamp"], d) for d in made]
    else:
        plans = recording.plan_at[(recording.plan_at >= goal.start) & (recording.plan_at <= goal.end)]
        if not len(plans):
            raise Skipped("no global plan was recorded for the goal")
        times = range(int(plans[0]), goal.end, int(PERIOD * SECOND))
        moments = [_moment(recording, goal, at) for at in times]
    if goal.end - moments[-1].at > 0.1 * SECOND and goal.end - moments[-1].at < 1.5 * PERIOD * SECOND:
        moments.append(_moment(recording, goal, goal.end))
    if len(moments) < 2:
        raise Skipped("shorter than one decision")
    return moments


def _moment(recording, goal, at, decision=None) -> Moment:
    if decision:
        scan = _exactly(recording.scan_stamp, decision["scan"])
        pose = _exactly(recording.odometry.stamp, decision["odometry"])
        plan = _exactly(recording.plan_stamp, decision["plan"])
    else:
        scan = _before(recording.scan_stamp, at)
        pose = _nearest(recording.odometry.stamp, recording.scan_stamp[scan]) if scan is not None else None
        plan = _before(recording.plan_at, at)
    for what, index, stamps in (("scan", scan, recording.scan_stamp), ("odometry", pose, recording.odometry.stamp)):
        if index is None or abs(int(stamps[index]) - at) > MAX_AGE * SECOND:
            raise Skipped("no %s for a decision" % what)
    if plan is None or recording.plan_at[plan] < goal.start - SECOND // 2:
        raise Skipped("no global plan for a decision")
    return Moment(at, scan, pose, plan, decision["number"] if decision else None)


def _outcome(recording, goal, moments, i, scans, plans, nearest) -> Outcome:
    """The Outcome (as of training/episode.py) at moment i, with what happened since moment i - 1."""
    moment = moments[i]
    frame, points = plans[moment.plan]
    pose = _pose(recording, moment.pose, frame, moment.at)
    scan = scans[moment.scan]
    try:
        check_scan(len(scan.ranges), scan.angle_min, scan.angle_increment)
        phi = goal_angle(local_goal(points, pose))
        observe(scan.ranges, phi, SPACE.theta0)
    except ObservationError as error:
        raise Skipped(_without_numbers(error)) from None
    near = max(NEAREST, float(nearest[moment.scan]))
    outcome = Outcome(np.asarray(scan.ranges, np.float32), phi, _theta(recording, moment.at), min_range=near,
                      lowest_range=near, decisions=i, time_s=(moment.at - moments[0].at) / SECOND)
    if i == 0:
        return outcome
    before = moments[i - 1]
    here, there = _pose(recording, moment.pose, goal.frame, moment.at), _pose(recording, before.pose, goal.frame, before.at)
    gx, gy = goal.xy[0] - there[0], goal.xy[1] - there[1]
    moved, distance = (here[0] - there[0], here[1] - there[1]), math.hypot(gx, gy)
    outcome.progress = (moved[0] * gx + moved[1] * gy) / distance if distance else 0.0
    outcome.progress_y = moved[1]
    outcome.seconds = (moment.at - before.at) / SECOND
    during = (recording.scan_stamp > before.at) & (recording.scan_stamp <= moment.at)
    if during.any():
        outcome.lowest_range = max(NEAREST, float(np.fmin.reduce(nearest[during])))
    outcome.contact = any(before.at < at <= moment.at for at in recording.collisions)
    outcome.jerk = _jerk(recording, before.at, moment.at)
    if i == len(moments) - 1 and goal.status is not None and goal.end - moment.at < 0.1 * SECOND:
        outcome.success = goal.status == SUCCEEDED
        outcome.aborted = goal.status in ABORTED
    return outcome


def _cut(goal, number, moments, outcomes, observations, reasons, recording, reward, layout, report):
    """Trajectories of consecutive usable transitions."""
    first = 0
    for i in range(1, len(moments) + 1):
        broken = i == len(moments) or reasons[i]
        if i < len(moments) and reasons[i]:
            report.skip(reasons[i])
        if not broken:
            continue
        if i - first >= 2:
            actions, rewards = [], []
            for j in range(first + 1, i):
                action = SPACE.to_action(_theta(recording, _applied(moments, j)))
                change = float(np.abs(action - SPACE.to_action(outcomes[j - 1].theta)).mean())
                rewards.append(reward(outcomes[j], change, max(LIMIT, len(moments)))[0])
                actions.append(action)
            last = outcomes[i - 1]
            report.episodes += 1
            report.transitions += len(rewards)
            yield Trajectory.of(layout, observations[first:i], actions, rewards, last.success or failed(last),
                                {"actor": "bag:" + recording.path.name[:180], "episode": number, "goal": goal.id[:180],
                                 "from": first, "success": bool(last.success)})
        first = i


def _unusable(recording, moments, i) -> str:
    """Why the transition that ends at moment i cannot be used; "" when it can."""
    if i == 0:
        return ""
    before, after = moments[i - 1].at, moments[i].at
    seconds = (after - before) / SECOND
    last = i == len(moments) - 1
    if seconds > 1.5 * PERIOD or (seconds < 0.5 * PERIOD and not last) or seconds <= 0:
        return "a decision's period is not 2 s"
    stamps = recording.scan_stamp[(recording.scan_stamp >= before) & (recording.scan_stamp <= after)]
    if len(stamps) < 2 or np.diff(stamps).max() > MAX_AGE * SECOND:
        return "scans are missing"
    try:
        settled = _theta(recording, _applied(moments, i))
        if not np.array_equal(settled, _theta(recording, after)):
            return "parameters were changed between decisions"
    except Skipped as reason:
        return str(reason)
    return ""


def _applied(moments, i) -> int:
    """A time at which the parameters chosen at moment i - 1 are in force: they arrive within a second or not at all."""
    return min(moments[i - 1].at + int(0.5 * PERIOD * SECOND), moments[i].at)


def _theta(recording, at) -> np.ndarray:
    """(8,) what the planner had at a time, as the servers announced it. Inflation: the local costmap's."""
    theta = np.array(SPACE.theta0)
    for i, name in enumerate(SPACE.names):
        target = SPACE.targets[name][0]
        updates = recording.parameters.get(target.server, ())
        known = [values for time, values in updates if time <= at] if updates else []
        value = next((known[-1][n] for n in target.names if n in known[-1]), None) if known else \
            _said(recording, name, at)
        theta[i] = value
    try:
        SPACE.to_action(theta)
    except SpaceError:
        raise Skipped("parameters are not finite") from None
    return theta


def _said(recording, name, at) -> float:
    """A parameter that no server announced before `at` (a split bag lacks the latched messages): the node's word."""
    for decision in recording.decisions:
        if decision["stamp"] >= at or decision is recording.decisions[-1]:
            value = decision["theta_prev"].get(name) if isinstance(decision["theta_prev"], dict) else None
            if isinstance(value, (int, float)):
                return float(value)
            break
    raise Skipped("the planner's parameters are not known")


def _compare(recording, moment, obs, report) -> None:
    seen = recording.observations.get(moment.number) if moment.number is not None else None
    if seen is None:
        return
    if seen.shape != obs.shape or not np.allclose(seen, obs, rtol=0.0, atol=CLOSE):
        raise Skipped("a rebuilt observation differs from the node's")
    report.verified += 1


def _check_motion(recording, goal) -> None:
    """Raises Skipped where the odometry says that robot or clock jumped while the goal was pursued."""
    during = (recording.odometry.stamp >= goal.start) & (recording.odometry.stamp <= goal.end)
    stamps, pose = recording.odometry.stamp[during], recording.odometry.pose[during]
    if len(stamps) < 2:
        raise Skipped("no odometry while the goal was pursued")
    if not np.isfinite(pose).all():
        raise Skipped("odometry is not finite")
    gaps = np.diff(stamps)
    if (gaps < 0).any() or (gaps == 0).mean() > 0.1:
        raise Skipped("the clock jumped")
    if (np.hypot(*np.diff(pose[:, :2], axis=0).T) > JUMP + 5.0 * gaps / SECOND).any():
        raise Skipped("the odometry jumped")
    stamps = recording.scan_stamp[(recording.scan_at >= goal.start) & (recording.scan_at <= goal.end)]
    if (np.diff(stamps) < 0).any():
        raise Skipped("the clock jumped")


def _pose(recording, index, frame, at) -> Tuple[float, float, float]:
    """Odometry number `index` as (x, y, yaw) in `frame`, through a recorded transform where frames differ."""
    x, y, a = recording.odometry.pose[index].tolist()
    if not frame or frame == recording.odometry.frame:
        return x, y, a
    known = [t for time, t in recording.transforms.get((frame, recording.odometry.frame), ()) if time <= at]
    if not known:
        raise Skipped("no transform between the plan's frame and the odometry's")
    tx, ty, ta = known[-1]
    c, s = math.cos(ta), math.sin(ta)
    return tx + c * x - s * y, ty + s * x + c * y, a + ta


def _jerk(recording, start, end) -> float:
    """Mean |change of acceleration| of the odometry's speed [m/s^3], at 50 ms as in simulation."""
    times = np.arange(start, end, SECOND // 20)
    speed = np.interp(times, recording.odometry.stamp, recording.odometry.twist[:, 0])
    return float(np.abs(np.diff(speed, 2)).mean() * 400.0) if len(times) > 2 else 0.0


def _exactly(stamps, stamp) -> Optional[int]:
    found = np.flatnonzero(stamps == stamp)
    return int(found[-1]) if len(found) else None


def _before(stamps, at) -> Optional[int]:
    found = np.flatnonzero(stamps <= at)
    return int(found[-1]) if len(found) else None


def _nearest(stamps, stamp) -> int:
    return int(np.argmin(np.abs(stamps - stamp)))


def _without_numbers(error) -> str:
    return "a scan or plan is unusable (%s)" % str(error).split(":")[0]
