"""Explanation of a replayed cycle: what outbid or refused the samples that drive on."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, normalize_angle_modulo, transform_point
from applr_ros1.drives.drive import Motion
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.robots.check import crossed_limits
from applr_ros1.why.moment import NEAR_M, CycleMoment, MetObstacle
from applr_ros1.why.replay import Replay, ReplayedCycle
from applr_ros1.why.rerun import RerunPlanner
from applr_ros1.why.stretch import SLOW

SAMPLES = 12  # number of samples in a table
# A part of the robot stays beside it in this share of the scans, at so many headings or more.
CARRIED = 0.9
HEADINGS = 5
TURNED = 0.3  # least difference of these headings [rad]
BESIDE_M = 0.3  # how far beyond the circumscribed circle it may lie [m, for the Jackal]


@dataclass
class Explanation:
    """Reason that kept the robot from driving on in one cycle.

    Attributes:
        at: Time of the cycle [s].
        pose: Pose of the robot (x, y, yaw) in the odometry frame.
        words: The reason in one clause; "" if the planner drove on.
        lines: What outbid the cheapest sample that drives on, and what refused the illegal ones.
        is_blocked: Whether all samples that drive on are illegal.
        obstacle: Cell (x, y) [m] that the straightest illegal sample meets, in the odometry frame,
            or None.
        points: Points (x, y, cost) of the legal trajectories.
        table: Names, the command, the cheapest sample that drives on, and the cheapest samples: v
            [m/s], w [rad/s], cost and its parts.
        driving: Row of the table with the cheapest sample that drives on, or None.
        plan: Points (x, y) of the plan that was followed.
    """

    at: float
    pose: Pose
    words: str = ""
    lines: List[str] = field(default_factory=list)
    is_blocked: bool = False
    obstacle: Optional[List[float]] = None
    points: List[List[float]] = field(default_factory=list)
    table: List[List[Any]] = field(default_factory=list)
    driving: Optional[int] = None
    plan: List[List[float]] = field(default_factory=list)

    def values(self) -> Dict[str, Any]:
        """Return JSON values for the page."""
        return asdict(self)


def explain(moment: CycleMoment) -> Explanation:
    """Return what kept the robot from driving on in a cycle."""
    asked = moment.asked
    explanation = Explanation(asked.at, asked.pose)
    crossing = _crossing(moment)
    # No place would make a difference to crossed limits.
    obstacle = None if crossing else moment.obstacle

    # What kept the planner from a sample that drives on
    drives_on = bool(moment.drives_on[moment.winner])
    if drives_on:
        explanation.words = _nothing_faster(moment)
        explanation.lines.append(f"The planner drives on {_in_words(moment, moment.winner)}.")
    elif moment.best is not None:
        _explain_outbid(explanation, moment, moment.best)
    if len(moment.illegal_rows):
        _explain_illegal(explanation, moment, crossing, obstacle)
    # Without straight commands, turns are all that is compared.
    if crossing and not drives_on:
        explanation.words = f"every straight command is refused, as {crossing}"
    # Nothing ahead is wanted then, so that what outbids or refuses it does not matter.
    elif moment.leads_back:
        explanation.words = "the plan leads back, behind the robot"

    # What the page shows
    explanation.points = moment.trajectory_points.round(2).tolist()
    explanation.table = _table(moment)
    if moment.best is not None:
        # The command comes first, so that the sample follows it, or is the command itself.
        explanation.driving = 1 if moment.best == moment.winner else 2
    explanation.plan = asked.plan[:, :2].round(2).tolist()
    return explanation


def _in_words(moment: CycleMoment, row: int) -> str:
    """Return the velocity of a sample for people."""
    v, w = moment.samples.velocities[row]
    return f"({v:.2f} m/s, {w:.2f} rad/s)"


def _nothing_faster(moment: CycleMoment) -> str:
    """Return that even the fastest sample is slow, or ""."""
    values = moment.values
    fastest_speed = moment.fastest_speed
    if fastest_speed >= SLOW * values["max_vel_x"]:
        return ""
    limits = f"vx_samples {values['vx_samples']:g}, acc_lim_x {values['acc_lim_x']:g}"
    # Both planners sample no speed with which sim_time would lead past the end of the plan.
    x, y, _ = moment.asked.pose
    end_x, end_y = moment.asked.plan[-1, :2]
    speed_to_end = math.hypot(end_x - x, end_y - y) / values["sim_time"]
    if speed_to_end < SLOW * values["max_vel_x"]:
        limits += f", sim_time {values['sim_time']:g} before the end of the plan"
    return f"no command faster than {fastest_speed:.2f} m/s is sampled ({limits})"


def _explain_outbid(explanation: Explanation, moment: CycleMoment, best: int) -> None:
    """Add why the cheapest sample that drives on was not chosen."""
    costs = moment.samples.costs
    winner = moment.winner
    driving = f"Driving on {_in_words(moment, best)}"
    # A planner that had compared both would have taken the cheaper one.
    if not 0.0 <= costs[winner] <= costs[best]:
        explanation.words = (
            "the planner is escaping: it samples no forward speed until it has moved by "
            "escape_reset_dist or turned by escape_reset_theta"
        )
        explanation.lines.append(f"{driving} was not sampled, because {explanation.words}.")
        return
    # The part of the costs that sets the two samples apart most is the reason.
    cost_gaps = {}
    for term, cost_part in moment.samples.parts.items():
        cost_gaps[term] = cost_part[best] - cost_part[winner]
    term = max(cost_gaps, key=lambda term: cost_gaps[term])
    weight = f"{term.parameter} {moment.values[term.parameter]:g}"
    explanation.words = f"every faster command {term.objection}, which costs too much at {weight}"
    cost_part = moment.samples.parts[term]
    explanation.lines.append(
        f"{driving} costs {costs[best]:.1f}, "
        f"the command {_in_words(moment, winner)} {costs[winner]:.1f}: "
        f"{weight} counts {cost_part[best]:.1f} against {cost_part[winner]:.1f}."
    )


def _explain_illegal(
    explanation: Explanation, moment: CycleMoment, crossing: str, obstacle: Optional[MetObstacle]
) -> None:
    """Add what refused the faster samples that are illegal, from the straightest one.

    Args:
        explanation: Explanation to add it to.
        moment: What the planner saw and said.
        crossing: Which limits leave no velocity to drive with, or "".
        obstacle: What the straightest one meets, or None.
    """
    straightest_row = moment.straightest_illegal
    if crossing:
        objection = f"is refused, as {crossing}"
    elif obstacle is not None:
        explanation.obstacle = list(obstacle.place)
        source = "the latest scan" if obstacle.is_in_scan else "earlier scans"
        objection = f"meets the obstacle {beside(obstacle.ahead, obstacle.left)}, from {source}"
    else:
        objection = _refusal(moment, straightest_row)
    illegal_count = len(moment.illegal_rows)
    faster_count = int(moment.drives_on.sum())
    if illegal_count == faster_count and not moment.drives_on[moment.winner]:
        explanation.is_blocked = True
        slowest_speed = moment.values.get("min_vel_trans", 0.0)
        if obstacle is not None or moment.fastest_speed >= slowest_speed:
            explanation.words = f"every faster command {objection}"
        # A robot that backs out brakes first, whatever its values: that is no reason.
        elif moment.fastest_speed - moment.asked.twist[0] < slowest_speed:
            explanation.words = _nothing_faster(moment)
    explanation.lines.append(
        f"{illegal_count} of {faster_count} faster samples are illegal; "
        f"{_in_words(moment, straightest_row)} {objection}."
    )


def _refusal(moment: CycleMoment, row: int) -> str:
    """Return why a sample is illegal that meets no obstacle."""
    values = moment.values
    v, _ = moment.samples.velocities[row].tolist()
    for term, cost_part in moment.samples.parts.items():
        if cost_part[row] < 0:
            return term.refusal.format(**values)
    # DWAPlannerROS scores no samples beyond its limits of the speed.
    if abs(v) > values.get("max_vel_trans", math.inf) + SLACK:
        return f"is above max_vel_trans ({values['max_vel_trans']:g})"
    if "min_vel_trans" in values:
        slowest_speed = values["min_vel_trans"]
        slowest_turn = values["min_vel_theta"]
        return f"is below min_vel_trans ({slowest_speed:g}) and min_vel_theta ({slowest_turn:g})"
    return "leaves the map or the reach of the plan"


def _crossing(moment: CycleMoment) -> str:
    """Return which limits of the planner leave no velocity to drive with, or ""."""
    for limits in crossed_limits(moment.planner, moment.values):
        if limits.consequence:
            largest = f"{limits.high} ({moment.values[limits.high]:g})"
            smallest = f"{limits.low} ({moment.values[limits.low]:g})"
            return f"{largest} is below {smallest}: {limits.consequence}"
    return ""


def beside(ahead: float, left: float, digits: int = 2) -> str:
    """Return in words where a point (x ahead, y left) [m] of the robot's frame is."""
    front_or_back = "ahead" if ahead >= 0.0 else "behind"
    side = "left" if left > 0.0 else "right"
    return f"{abs(ahead):.{digits}f} m {front_or_back} and {abs(left):.{digits}f} m to the {side}"


def _table(moment: CycleMoment) -> List[List[Any]]:
    """Return names and rows of the command, the cheapest sample that drives on, and others."""
    velocities, costs, parts = moment.samples
    rows = np.column_stack([velocities, costs, *parts.values()]).round(2)
    rows_by_cost = costs.argsort()
    cheapest_rows = rows_by_cost[costs[rows_by_cost] >= 0].tolist()
    shown_rows = [moment.winner]
    if moment.best is not None:
        shown_rows.append(moment.best)
    shown_rows += cheapest_rows[:SAMPLES]
    distinct_rows = list(dict.fromkeys(shown_rows))
    titles = [f"{term.title} ({term.name})" for term in parts]
    return [["v", "w", "cost", *titles], *rows[distinct_rows].tolist()]


def at_goal(planner: RerunPlanner, settings: Settings) -> str:
    """Return in words what keeps a robot at its goal from ending it."""
    # Some planners read their tolerances only once.
    values = {**planner.start_values, **settings[planner.name]}
    tolerance = values["yaw_goal_tolerance"]
    # The slowest turn on the spot has a parameter of its own in TrajectoryPlannerROS.
    turn_parameter = "min_in_place_vel_theta"
    if turn_parameter not in values:
        turn_parameter = "min_vel_theta"
    turn_of_cycle = abs(values[turn_parameter]) * planner.period
    # Each cycle then turns past the tolerance on both sides of the goal's heading.
    if turn_of_cycle > 2.0 * tolerance:
        return (
            f"yaw_goal_tolerance {tolerance:g} is smaller than the turn of one cycle "
            f"at {turn_parameter} {abs(values[turn_parameter]):g}"
        )
    heading_tolerance = f"yaw_goal_tolerance {tolerance:g}"
    place_tolerance = f"xy_goal_tolerance {values['xy_goal_tolerance']:g}"
    return f"it does not come within {place_tolerance} and {heading_tolerance} of the goal at once"


def part_of_robot(replay: Replay) -> Optional[Tuple[float, float]]:
    """Return where (x, y) [m] beside the turning robot nearly all scans have a point, or None.

    A robot that stands or drives straight on proves nothing: a wall along its way stays beside it.
    """
    x, y = replay.footprint.T
    reach = float(np.hypot(x, y).max()) + BESIDE_M * replay.robot.world_scale
    turned_cycles = _distinct_headings(replay.cycles)
    if len(turned_cycles) < HEADINGS:
        return None

    # Scans with a point in each cell beside the robot
    counts: Counter[Tuple[float, float]] = Counter()
    for cycle in turned_cycles:
        x, y = replay.cloud(cycle.scan).points[:, :2].T
        ahead_of_robot, left_of_robot = transform_point(inverse(cycle.pose), x, y)
        is_beside = np.hypot(ahead_of_robot, left_of_robot) <= reach
        points = np.column_stack([ahead_of_robot, left_of_robot])[is_beside]
        cells = np.unique(np.rint(points / NEAR_M), axis=0) * NEAR_M
        for cell_x, cell_y in cells.tolist():
            counts[cell_x, cell_y] += 1
    if not counts:
        return None
    most_seen_place, scan_count = counts.most_common(1)[0]
    if scan_count <= CARRIED * len(turned_cycles):
        return None
    return most_seen_place


def has_turned(motion: Motion) -> bool:
    """Return whether a robot may have turned enough for part_of_robot to return a place."""
    return bool(np.ptp(np.unwrap(motion.pose[:, 2])) >= (HEADINGS - 1) * TURNED)


def _distinct_headings(cycles: Sequence[ReplayedCycle]) -> List[ReplayedCycle]:
    """Return cycles whose headings are at least TURNED apart from each other."""
    distinct_cycles: List[ReplayedCycle] = []
    headings = np.empty(0)
    for cycle in cycles:
        yaw = cycle.pose[2]
        turns = np.abs(normalize_angle_modulo(headings - yaw))
        if not (turns < TURNED).any():
            distinct_cycles.append(cycle)
            headings = np.append(headings, yaw)
    return distinct_cycles
