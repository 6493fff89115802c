"""Rebuilds the transitions (s, theta, r, s', terminated, truncated) of the paper's MDP from a Recording, goal by goal.

bags_to_dataset.py calls it. Where the bag holds the applr node's decisions, each observation is rebuilt from the very
messages that the node saw, and compared, and the decision period is that of the decisions; otherwise decisions are
taken to fall every two seconds from a goal's first plan on.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Iterator, List, Optional, Set, Tuple

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.observation import ObservationError, goal_angle, local_goal, observe
from training.bags.goals import ABORTED, SUCCEEDED, goals
from training.bags.reader import SECOND, Recording
from training.env.episode import TIME_LIMIT
from training.env.episode import nearest as smallest
from training.env.outcome import Outcome
from training.env.reward import Reward, failed
from training.replay.trajectory import Trajectory, TransitionLayout

MAX_AGE = 1.0  # s; older scans, poses and plans are no basis for a decision
JUMP = 0.3  # m beyond what 5 m/s covers: the robot was put elsewhere, or the clock was
EARLIER = SECOND // 4  # a recorder's clock may lag so far behind the node's
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
    skipped: Counter[str] = field(default_factory=Counter)  # by reason

    def skip(self, reason: str) -> None:
        """Count a transition that is not used, by the reason."""
        self.skipped[reason] += 1


@dataclass
class Sample:
    """An observation to be rebuilt from messages, and what came of it.

    Attributes:
        at: ROS time [ns]. end: the course ends here, and no decision was made.
        seen, said: the observation (n,) and the decision (k,) that the node itself published, if recorded.
        scan, pose, plan: indices of the messages that the observation is made of; -1 for none.
        trouble: why it cannot be rebuilt (outcome is None), or why the transition that ends here cannot be used.
    """

    at: int
    end: bool = False
    seen: Optional[np.ndarray] = None
    said: Optional[np.ndarray] = None
    scan: int = -1
    pose: int = -1
    plan: int = -1
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
    for goal in goals(recording, report.skip):
        try:
            _check_motion(recording, goal)
            _finish(recording, goal, finish)
            courses.append((goal, _samples(recording, goal)))
            report.periods.add(goal.period)
        except Skipped as reason:
            report.skip(str(reason))
    usable = [m for _, samples in courses for m in samples if not m.trouble]
    nearest, scans = recording.scans(m.scan for m in usable)
    plans = recording.plans(m.plan for m in usable)
    for number, (goal, samples) in enumerate(courses):
        for i in range(len(samples)):
            _see(recording, goal, samples, i, scans, plans, nearest, report)
        yield from _cut(recording, goal, number, samples, reward, layout, report)


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


def _samples(recording, goal) -> List[Sample]:
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
        samples = [
            _sample(recording, goal, at) for at in range(int(plans[0]), goal.end + 1, round(goal.period * SECOND))
        ]
    if goal.end - samples[-1].at > (0 if goal.ended else 0.9 * goal.period * SECOND):
        samples.append(_sample(recording, goal, goal.end))
        samples[-1].end = True
    if len(samples) < 2:
        raise Skipped("shorter than one decision")
    return samples


def _sample(recording, goal, at, decision=None) -> Sample:
    sample = Sample(at)
    if decision:
        published = recording.observations.get(decision["number"], ())  # numbers begin anew with each node
        sample.seen = min(published, key=lambda o: abs(o[0] - decision["at"]), default=(0, None))[1]
        sample.said = _vector(recording, decision["theta"] or decision["theta_prev"])
        sample.scan = _exactly(recording.scan_stamp, decision["scan"])
        sample.pose = _exactly(recording.odometry.stamp, decision["odometry"])
        sample.plan = _exactly(recording.plan_stamp, decision["plan"])
    else:
        sample.scan = _before(recording.scan_stamp, at)
        sample.pose = _nearest(recording.odometry.stamp, recording.scan_stamp[sample.scan])
        sample.plan = _before(recording.plan_at, at)
    for what, index, stamps in (
        ("scan", sample.scan, recording.scan_stamp),
        ("odometry", sample.pose, recording.odometry.stamp),
    ):
        if index < 0 or abs(int(stamps[index]) - at) > MAX_AGE * SECOND:
            sample.trouble = f"no {what} for a decision"
    if sample.plan < 0 or recording.plan_at[sample.plan] < goal.start - SECOND // 2:
        sample.trouble = "no global plan for a decision"
    return sample


def _see(recording, goal, samples, i, scans, plans, nearest, report) -> None:
    """Fills sample i with what was seen at it and what happened since sample i - 1, or says what is wrong."""
    sample = samples[i]
    if sample.trouble:
        return
    try:
        scan, (frame, points) = scans[sample.scan], plans[sample.plan]
        layout, turned = recording.layout, recording.robot.laser.pose[2]
        ranges = layout.resample(scan.ranges, scan.angle_min + turned, scan.angle_increment)
        pose = _pose(recording, sample.pose, frame, sample.at)
        phi = goal_angle(local_goal(points, pose, layout.lookahead))
        theta = _chosen(recording, goal, samples[i - 1], sample) if sample.end and i else _had(recording, sample)
        sample.observation = observe(ranges, phi, theta, recording.space, layout)
        near = smallest(nearest[[sample.scan]], recording.robot.laser.range_min)
        sample.outcome = Outcome(
            ranges,
            phi,
            theta,
            last_scan_min=near,
            decision_min=near,
            decisions=i,
            time_s=(sample.at - samples[0].at) / SECOND,
        )
        _compare(sample, report)
        if i and samples[i - 1].outcome is not None:
            _happened(recording, goal, samples[i - 1], sample, nearest)
            sample.trouble = _unusable(recording, goal, samples, i)
    except ObservationError as error:
        sample.outcome, sample.trouble = None, f"a scan or plan is unusable ({str(error).split(':')[0]})"
    except Skipped as reason:
        sample.outcome, sample.trouble = None, str(reason)


def _happened(recording, goal, before, sample, nearest) -> None:
    """The parts of an Outcome that a transition has: progress, clearance, contact, jerk, the end."""
    outcome = sample.outcome
    here = _pose(recording, sample.pose, goal.frame, sample.at)
    there = _pose(recording, before.pose, goal.frame, before.at)
    gx, gy = goal.xy[0] - there[0], goal.xy[1] - there[1]
    moved, distance = (here[0] - there[0], here[1] - there[1]), math.hypot(gx, gy)
    outcome.progress = (moved[0] * gx + moved[1] * gy) / distance if distance else 0.0
    outcome.progress_y = moved[1]
    outcome.seconds = (sample.at - before.at) / SECOND
    during = (recording.scan_stamp > before.at) & (recording.scan_stamp <= sample.at)
    if during.any():
        outcome.decision_min = smallest(nearest[during], recording.robot.laser.range_min)
    outcome.contact = any(before.at < at <= sample.at for at in recording.collisions)
    if goal.ended and sample.at == goal.end:
        outcome.success, outcome.aborted = goal.status == SUCCEEDED, goal.status in ABORTED


def _cut(recording, goal, number, samples, reward, layout, report) -> Iterator[Trajectory]:
    """Trajectories of consecutive usable transitions."""
    run: List[Sample] = []
    for sample in samples + [None]:
        if sample is not None and sample.trouble:
            report.skip(sample.trouble)
        if run and (sample is None or sample.trouble):
            if len(run) > 1:
                yield _trajectory(recording, goal, number, run, reward, layout, report)
            run = []
        if sample is not None and sample.outcome is not None:
            run.append(sample)


def _trajectory(recording, goal, number, run, reward, layout, report) -> Trajectory:
    actions, rewards = [], []
    for before, after in zip(run, run[1:]):
        space = recording.space.paper
        action = space.to_action(_chosen(recording, goal, before, after))
        change = float(np.abs(action - space.to_action(before.outcome.theta)).mean())
        limit = max(round(TIME_LIMIT / goal.period), after.outcome.decisions)
        rewards.append(reward(after.outcome, change, limit, goal.period, scale=1.0)[0])
        actions.append(action)
    last = run[-1].outcome
    report.episodes += 1
    report.transitions += len(rewards)
    return Trajectory.of(
        layout,
        [m.observation for m in run],
        actions,
        rewards,
        last.success or failed(last),
        {
            "actor": "bag:" + recording.path.name[:180],
            "episode": number,
            "goal": goal.id[:180],
            "from": run[0].outcome.decisions,
            "success": bool(last.success),
        },
    )


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
    if not np.array_equal(_chosen(recording, goal, before, after), after.outcome.theta):
        return "parameters were changed between decisions"
    return ""


def _had(recording, sample) -> np.ndarray:
    """The parameters theta_{t-1} (k,) that the planner had when a decision was made.

    An update that was recorded within EARLIER of the decision is its result rather than its input, unless the
    observation that the node itself published says otherwise.
    """
    found = []
    for lag in (EARLIER, EARLIER // 5, 0):
        try:
            found.append(_theta(recording, sample.at - lag))
        except Skipped:
            if not lag and not found:
                raise
    space = recording.space.paper
    if sample.seen is not None and sample.seen.shape == (recording.layout.beams + 1 + len(space),):
        for theta in found:
            if np.allclose(space.to_action(theta), sample.seen[-len(space) :], rtol=0.0, atol=CLOSE):
                return theta
    return found[0]


def _chosen(recording, goal, before, after) -> np.ndarray:
    """theta_t (k,): what the planner had between two samples. It arrives within half a period or not at all."""
    half = round(0.5 * goal.period * SECOND)
    if before.said is not None and after.at - before.at < half:
        return before.said
    return _theta(recording, min(before.at + half, after.at))


def _theta(recording, at) -> np.ndarray:
    """(k,) what the planner had at a time, as the servers announced it. Inflation: the local costmap's."""
    theta = np.array(recording.space.theta0)
    for i, name in enumerate(recording.space.names):
        target = recording.space.targets[name][0]
        updates = recording.parameters.get(target.server, ())
        known = [values for time, values in updates if time <= at]
        theta[i] = (
            next(known[-1][n] for n in target.names if n in known[-1]) if known else _published(recording, name, at)
        )
    if not np.isfinite(theta).all():
        raise Skipped("parameters are not finite")
    return theta


def _published(recording, name, at) -> float:
    """A parameter that no server announced before `at` (a split bag lacks the latched messages): the node's word."""
    said = next((d["theta_prev"] for d in recording.decisions if d["stamp"] >= at), None)
    if isinstance(said, dict) and isinstance(said.get(name), (int, float)):
        return float(said[name])
    raise Skipped("the planner's parameters are not known")


def _vector(recording, values) -> Optional[np.ndarray]:
    """{name: value} of a decision → theta (k,), None where it is not whole."""
    try:
        return np.array([float(values[name]) for name in recording.space.names])
    except (KeyError, TypeError, ValueError):
        return None


def _compare(sample, report) -> None:
    seen = sample.seen
    if seen is None:
        return
    if seen.shape != sample.observation.shape or not np.allclose(seen, sample.observation, rtol=0.0, atol=CLOSE):
        raise Skipped("a rebuilt observation differs from the node's")
    report.verified += 1


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


def _pose(recording, index, frame, at) -> Tuple[float, float, float]:
    """Odometry number `index` as (x, y, yaw) in `frame`, through a recorded transform where frames differ."""
    x, y, a = recording.odometry.pose[index].tolist()
    if not frame or frame == recording.odometry.frame:
        return x, y, a
    known = [t for time, t in recording.transforms.get((frame, recording.odometry.frame), ()) if time <= at]
    if not known:
        raise Skipped("no transform between the plan's frame and the odometry's")
    return (*transform_point(known[-1], x, y), a + known[-1][2])


def _exactly(stamps, stamp) -> int:
    found = np.flatnonzero(stamps == stamp)
    return int(found[-1]) if len(found) else -1


def _before(stamps, at) -> int:
    found = np.flatnonzero(stamps <= at)
    return int(found[-1]) if len(found) else -1


def _nearest(stamps, stamp) -> int:
    return int(np.argmin(np.abs(stamps - stamp)))
