"""Conversion of the decisions of a drive to transitions (s, theta, r, s', terminated, truncated).

bags_to_dataset.py calls transitions(). A recorded decision contains the method's parameters and the
raw inputs. Any encoding makes the same observation from these inputs as in the node and in the
learning environment. The outcome follows from the action's status, the odometry and the scans.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import step_lengths
from applr_ros1.drives.clocks import scans_apart
from applr_ros1.drives.columns import TopicNames, topic_of
from applr_ros1.drives.drive import REACHED, Decision, Drive, Goal, Measured, Motion, Scans
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.outcome import Leg, Outcome, outcome_of
from applr_ros1.policy.decision import PERIOD, Context, Seen
from applr_ros1.policy.dimensionless import ENCODINGS
from applr_ros1.policy.encoding import PAPER, Encoding
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.senses.standing import USABLE_AGE_S
from applr_ros1.stack.simulated import CONTROL_PERIOD
from training.bags.read import BagError
from training.env.reward import Reward, failed
from training.env.trajectory import Trajectory, TransitionLayout

# Columns of a recorded drive that transitions need
COLUMNS = ("scans", "odometry", "goals", "decisions", "ends", "contacts")
FASTEST_M_S = 5.0  # speed beyond which no robot drives [m/s]
# Movement between two poses that counts as a jump, in addition to that at FASTEST_M_S [m]
JUMP_M = 0.3
STOOD_M = 0.02  # distance between two decisions below which the robot stood [m]


class Skipped(ApplrError):
    """Error of an unusable episode.

    The message is the reason without numbers, so that reasons can be counted.
    """


class Moment(NamedTuple):
    """Moment of a course: a decision, or an end, with the robot's place (x, y) [m]."""

    decision: Decision
    seen: Seen
    place: Tuple[float, ...]
    is_end: bool


class Recorded(NamedTuple):
    """Columns of a drive that gives transitions.

    Attributes:
        drive: The drive, for outcomes.
        scans: Laser scans.
        odometry: Motion by odometry.
        decisions: Decisions of the method.
        ends: Observations of the method at the ends of courses.
    """

    drive: Drive
    scans: Scans
    odometry: Motion
    decisions: List[Moment]
    ends: List[Moment]


@dataclass
class State:
    """State of the learning problem: a decision, or the end of a course.

    Attributes:
        moment: The decision, with the robot's place in its frame; at the end of a course, or where
            it was interrupted, the observation there instead.
        theta: (k,) current parameters after the decision.
        observation: Observation on which the decision is based.
        outcome: Outcome of the previous decision.
    """

    moment: Moment
    theta: np.ndarray
    observation: np.ndarray
    outcome: Outcome

    @property
    def time(self) -> float:
        """Time of the decision [s]."""
        return self.moment.decision.time


def transitions(
    drive: Drive,
    robot: Robot = JACKAL,
    observation: str = PAPER,
    reward: Reward = Reward(),
    finish: Optional[float] = None,
    topics: TopicNames = TopicNames(),
) -> Tuple[List[Trajectory], Counter[str]]:
    """Return a Trajectory for each usable part of the drive to each goal.

    Args:
        drive: Recorded drive with COLUMNS.
        robot: Robot that drove.
        observation: Name of the encoding of the transitions.
        reward: Reward of a transition.
        finish: Distance towards the goal [m] after which a course counts as finished although
            move_base drives on (the paper's goal lies beyond the finish line). None: only the
            result of move_base counts.
        topics: Names of the recorded topics, for messages.

    Returns:
        The trajectories, and the numbers of unusable parts by reason.

    Raises:
        BagError: The drive lacks required data.
    """
    encoding = ENCODINGS[observation](robot, decision_period(drive) or PERIOD)
    recorded = _recorded(drive, encoding, topics)
    trajectories: List[Trajectory] = []
    skipped: Counter[str] = Counter()
    for goal in drive.goals:
        try:
            check_motion(recorded.odometry, goal)
            states = _states(recorded, encoding, goal, finish)
        except Skipped as reason:
            skipped[str(reason)] += 1
            continue
        for run in _usable_runs(recorded.scans, encoding, states, skipped):
            trajectories.append(_trajectory(encoding, run, reward))
    return trajectories, skipped


def _recorded(drive: Drive, encoding: Encoding, topics: TopicNames) -> Recorded:
    """Return the columns of a drive for transitions of this encoding.

    Raises:
        BagError: The drive lacks required data.
    """
    if not drive.decisions:
        topic = topic_of("decisions", topics)
        raise BagError(
            f"no decisions on {topic}: record a drive of the applr node with record:=FILE"
        )
    for column in ("scans", "odometry", "goals"):
        if not getattr(drive, column):
            raise BagError(f"no {column} on {topic_of(column, topics)}")
    decisions = _observed(drive.decisions, is_end=False)
    ends = _observed(drive.ends, is_end=True)
    odometry, scans = drive.require(Measured)
    apart = scans_apart(scans, odometry)
    if apart:
        raise BagError(apart)
    parameter_names = list(drive.decisions[0].before)
    if set(parameter_names) != set(encoding.space.names):
        parameters = ", ".join(parameter_names)
        raise BagError(f"its decisions set {parameters}: give the --robot with these parameters")
    return Recorded(drive, scans, odometry, decisions, ends)


def _observed(decisions: Sequence[Decision], is_end: bool) -> List[Moment]:
    """Return decisions, or the ends of courses, with their inputs.

    Raises:
        BagError: An older node published them without the inputs that they were based on.
    """
    observed = []
    for decision in decisions:
        seen = decision.seen
        if seen is None:
            raise BagError("its decisions were recorded by an older version, without their inputs")
        observed.append(Moment(decision, seen, seen.pose[:2], is_end))
    return observed


# -- courses ---------------------------------------------------------------------------------------
def decision_period(drive: Drive) -> Optional[float]:
    """Return the decision period [s], in whole control cycles, or None if no goal shows it.

    It is the median interval between a goal's decisions.
    """
    times_by_goal: Dict[str, List[float]] = {}
    for decision in drive.decisions:
        times_by_goal.setdefault(decision.goal, []).append(decision.time)
    intervals: List[float] = []
    for times in times_by_goal.values():
        intervals.extend(np.diff(times))
    if not intervals:
        return None
    cycles = max(1, round(float(np.median(intervals)) / CONTROL_PERIOD))
    return round(cycles * CONTROL_PERIOD, 9)


def check_motion(motion: Motion, goal: Goal) -> None:
    """Raise Skipped if the odometry jumped while the goal was pursued, as the clock may have."""
    is_pursued = (motion.stamp >= goal.begin) & (motion.stamp <= goal.end)
    if is_pursued.sum() < 2:
        raise Skipped("no odometry while the goal was pursued")
    lengths = step_lengths(motion.pose[is_pursued, :2])
    if (lengths > JUMP_M + FASTEST_M_S * np.diff(motion.stamp[is_pursued])).any():
        raise Skipped("the odometry jumped")


# -- states ----------------------------------------------------------------------------------------
def _states(
    recorded: Recorded, encoding: Encoding, goal: Goal, finish: Optional[float]
) -> List[State]:
    """Return the states at a goal's decisions and at the ends and interruptions of its course."""
    decisions = _of_goal(recorded.decisions, goal, goal.end)
    if not decisions:
        raise Skipped("no decision was recorded for the goal")
    ends = _of_goal(recorded.ends, goal, goal.end + USABLE_AGE_S)
    if finish is not None:
        goal = _finished(recorded.odometry, goal, decisions, finish)
        decisions = _of_goal(decisions, goal, goal.end)
        ends = _of_goal(ends, goal, goal.end)
    moments = _moments(recorded.odometry, goal, decisions, ends)
    if len(moments) < 2:
        raise Skipped("shorter than one decision")

    states: List[State] = []
    encoding.forget_decision()
    for decision_count, moment in enumerate(moments):
        decision = moment.decision
        theta_before = _theta(encoding, decision.before)
        theta_after = _theta(encoding, decision.after or decision.before)
        context = Context.of(theta_before, moment.seen, encoding.space, encoding.layout)
        outcome = Outcome(theta_before, decisions=decision_count)
        observation = encoding.observe(context)
        states.append(State(moment, theta_after, observation, outcome))
        if decision_count:
            # Only the last decision of a course leads to the goal's result.
            is_last = decision_count == len(moments) - 1 and moment.is_end and goal.has_ended
            result = goal if is_last else goal._replace(status="")
            states[-1].outcome = _outcome(recorded.drive, encoding.robot, result, *states[-2:])
        if moment.is_end:
            # The encoding remembers earlier observations, which a new course must not see.
            encoding.forget_decision()
    return states


def _of_goal(moments: Sequence[Moment], goal: Goal, until: float) -> List[Moment]:
    """Return the decisions or ends of a goal until a time [s]."""
    moments_of_goal = []
    for moment in moments:
        if moment.decision.goal == goal.id and moment.decision.time <= until:
            moments_of_goal.append(moment)
    return moments_of_goal


def _moments(
    odometry: Motion, goal: Goal, decisions: Sequence[Moment], ends: Sequence[Moment]
) -> List[Moment]:
    """Return decisions and ends in order of time.

    The node publishes its observation a moment after an end. If this message is missing, a goal
    that was reached or aborted ends with the observation of the last decision, because the value of
    a terminal state is not used.
    """
    moments = [*decisions]
    for end in ends:
        in_time = end.decision._replace(time=min(end.decision.time, goal.end))
        moments.append(end._replace(decision=in_time))
    moments.sort(key=lambda moment: moment.decision.time)

    latest_moment = moments[-1]
    is_recorded = latest_moment.is_end and latest_moment.decision.time > goal.end - USABLE_AGE_S
    last_moment = decisions[-1]
    last_decision = last_moment.decision
    if goal.has_ended and last_decision.time < goal.end and not is_recorded:
        values_at_end = last_decision.after or last_decision.before
        end_decision = last_decision._replace(time=goal.end, before=values_at_end)
        _, places = _driven(odometry, last_moment, goal.end)
        moments.append(Moment(end_decision, last_moment.seen, tuple(places[-1]), is_end=True))
    return moments


def _finished(odometry: Motion, goal: Goal, decisions: List[Moment], finish: float) -> Goal:
    """Return the goal, which ends as reached once the robot has driven `finish` [m] towards it."""
    start_position = np.array(decisions[0].place)
    end_times = [*(moment.decision.time for moment in decisions[1:]), goal.end]
    for moment, until in zip(decisions, end_times):
        times, places = _driven(odometry, moment, until)
        towards = np.array(moment.seen.goal[:2]) - start_position
        is_past = (places - start_position) @ towards >= finish * np.hypot(*towards)
        if is_past.any():
            return goal._replace(end=float(times[np.argmax(is_past)]), status=REACHED)
    return goal


def _driven(motion: Motion, moment: Moment, until: float) -> Tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [s] and positions (n, 2) [m] of the robot after a decision.

    The positions are in the decision's frame. They begin with the pose in the decision, which is
    for the time of its scan, and continue by odometry.
    """
    first_row = int(np.argmin(np.abs(motion.stamp - moment.decision.scan_time)))
    later_rows = np.flatnonzero((motion.stamp > motion.stamp[first_row]) & (motion.stamp <= until))
    rows = np.append(first_row, later_rows)
    # Transform that brings the odometry's first pose to that in the decision
    from_odometry = compose(moment.seen.pose, inverse(tuple(motion.pose[first_row].tolist())))
    x, y = transform_point(from_odometry, motion.pose[rows, 0], motion.pose[rows, 1])
    return motion.stamp[rows], np.column_stack([x, y])


def _theta(encoding: Encoding, values: Dict[str, float]) -> np.ndarray:
    """Return theta (k,) from a decision's parameters {name: value}."""
    return np.array([values[name] for name in encoding.space.names])


def _outcome(drive: Drive, robot: Robot, goal: Goal, before: State, after: State) -> Outcome:
    """Return the outcome of the decision in the state `before`, which led to `after`."""
    leg = Leg(
        begin=before.time,
        end=after.time,
        goal=before.moment.seen.goal,
        start_place=before.moment.place,
        end_place=after.moment.place,
    )
    expected = after.outcome
    return outcome_of(
        drive, goal, leg, expected.theta, expected.decisions, body_width=robot.body.size[1]
    )


def _unusable(scans: Scans, encoding: Encoding, before: State, after: State) -> str:
    """Return why a transition cannot be used, or "" if it can."""
    # The reward is for a period: a much shorter or longer one would be another problem's.
    seconds = after.time - before.time
    is_early = seconds < 0.5 * encoding.period and not after.outcome.over
    if is_early and after.moment.is_end:
        return "a course was interrupted soon after a decision"
    if is_early or seconds > 1.5 * encoding.period:
        return "a decision's period differs from the others"

    # Without scans, a contact or a small clearance may have been missed.
    is_near = (scans.stamp >= before.time - USABLE_AGE_S) & (scans.stamp <= after.time)
    stamps = scans.stamp[is_near]
    if len(stamps) < 2 or np.diff(stamps).max() > USABLE_AGE_S:
        return "scans are missing"
    # A person, or a refusal of the planner, may have set other values.
    if not np.array_equal(before.theta, after.outcome.theta):
        return "parameters were changed between decisions"
    return ""


# -- episodes --------------------------------------------------------------------------------------
def _usable_runs(
    scans: Scans, encoding: Encoding, states: List[State], skipped: Counter[str]
) -> Iterator[List[State]]:
    """Yield runs of states with usable transitions between them.

    Count the other transitions in `skipped`.
    """
    run = states[:1]
    for before, after in zip(states, states[1:]):
        reason = ""
        if not before.moment.is_end:
            reason = _unusable(scans, encoding, before, after)
        if reason:
            skipped[reason] += 1
        if reason or before.moment.is_end:
            if len(run) > 1:
                yield run
            run = []
        run.append(after)
    if len(run) > 1:
        yield run


def _trajectory(encoding: Encoding, run: List[State], reward: Reward) -> Trajectory:
    """Return the transitions between the states of a run.

    The info has the number of those in which the robot "stood" or only turned on the spot.
    """
    actions = []
    rewards = []
    stood = 0
    outcome = run[0].outcome
    for before, after in zip(run, run[1:]):
        actions.append(encoding.action(before.theta))
        outcome = after.outcome
        # A recorded drive may take longer than a trial: nothing is left of the limit then.
        limit = max(Rules().periods(encoding.period), outcome.decisions)
        total_reward, _ = reward(outcome, limit, encoding.period, encoding)
        rewards.append(total_reward)
        stood += math.dist(before.moment.place, after.moment.place) < STOOD_M
    observations = [state.observation for state in run]
    terminated = outcome.success or failed(outcome)
    layout = TransitionLayout.of(encoding)
    return Trajectory.of(layout, observations, actions, rewards, terminated, {"stood": stood})
