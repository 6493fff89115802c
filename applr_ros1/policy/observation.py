"""Observation of the paper, in [-1, 1]: s = (o_t, phi_t, theta_{t-1}) (section III-B).

The applr node, the learning environment and the bag reader call `observe`, so that all three use
the same vector.
"""

from functools import lru_cache
from math import atan2, pi
from typing import Any, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common.angles import transform_point
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.policy.layout import Layout, ObservationError
from applr_ros1.policy.parameter_space import SPACE, Space
from applr_ros1.robots import Robot

MOST_BEAMS = 720  # largest number of beams in a default layout, as in the paper
RANGE_CAP_M = 2.0  # range cap of the paper's scan at the Jackal's scale [m]
LOOKAHEAD_M = 1.0  # lookahead distance of the paper's local goal at the Jackal's scale [m]
FARTHEST_M = 4.0  # longest lookahead distance of all encodings at the Jackal's scale [m]
# Window [points] and order of the Savitzky-Golay filter that smooths the plan
WINDOW = 19
ORDER = 3


def half_view_of(robot: Robot, least: float) -> float:
    """Return the angle [rad] up to which a robot's laser sees to both sides of straight ahead.

    Raise ObservationError unless it is more than `least` [rad].
    """
    if robot.laser.covers_full_turn:
        return pi
    first_angle, last_angle = robot.laser.view
    half_view = min(-first_angle, last_angle)
    if half_view <= least:
        view = f"{first_angle:.3f} to {last_angle:.3f} rad"
        raise ObservationError(f"robot {robot.name}: its laser covers {view}, not ahead")
    return half_view


@lru_cache(maxsize=32)
def layout_of(robot: Robot) -> Layout:
    """Return the default layout of new policies for a robot.

    The beams are symmetric about straight ahead: those that the laser has in such a sector, but at
    most MOST_BEAMS. Range cap and lookahead are the paper's 2 m and 1 m times the scale of the
    robot's worlds.
    """
    laser = robot.laser
    beams = min(laser.beams, MOST_BEAMS)
    half_view = half_view_of(robot, laser.increment)
    if laser.covers_full_turn:
        half_view -= pi / beams  # A beam at pi would be the same as one at -pi.
    else:
        beams = min(MOST_BEAMS, int(round(2.0 * half_view / laser.increment)) + 1)
    return Layout(
        beams=beams,
        angle_min=-half_view,
        angle_max=half_view,
        range_cap=RANGE_CAP_M * robot.world_scale,
        lookahead=LOOKAHEAD_M * robot.world_scale,
    )


LAYOUT = layout_of(robots.JACKAL)  # 720 beams over 270 degrees, capped at 2 m


def observe(
    ranges: Any, phi: float, theta_prev: Any, space: Space = SPACE, layout: Layout = LAYOUT
) -> Array32:
    """Return the observation (beams + 1 + k,) float32: scan, phi / pi and theta_prev, in [-1, 1].

    The Jackal's observation has 720 ranges r [m], capped at 2 m and scaled to r - 1, one angle and
    eight parameters.

    Args:
        ranges: (beams,) [m] from layout.resample. By REP 117 +inf is no return (the cap) and -inf
            is too near (0 m). NaN is no measurement and is interpolated between its valid
            neighbours.
        phi: Angle of the local goal [rad].
        theta_prev: (n,) current parameters of the planner. Values outside their bounds are clipped.
        space: Parameter space of n parameters. The observation has only the k that the policy sets
            (space.chosen).
        layout: Layout of the scan.

    Raises:
        ObservationError: The number of beams is wrong, no beam is valid, or phi is not finite.
    """
    beams = layout.beams
    scaled_ranges = scaled(without_gaps(ranges, layout), layout)
    if not np.isfinite(phi):
        raise ObservationError(
            f"angle of the local goal is {phi}: check the pose and the global plan"
        )
    parameters = space.chosen.to_action(space.chosen_of(theta_prev))
    observation = np.empty(beams + 1 + len(parameters), dtype=np.float32)
    observation[:beams] = scaled_ranges
    observation[beams] = np.clip(phi / pi, -1.0, 1.0)
    observation[beams + 1 :] = parameters
    return observation


def scaled(ranges: Any, layout: Layout = LAYOUT) -> Array32:
    """Return ranges without NaN [m] as a policy gets them: capped, and scaled to [-1, 1]."""
    capped_ranges = np.clip(np.asarray(ranges, np.float32), 0.0, layout.range_cap)
    return capped_ranges * (2.0 / layout.range_cap) - 1.0


def without_gaps(ranges: Any, layout: Layout = LAYOUT) -> Array32:
    """Return ranges (beams,) float32 [m] with NaN interpolated between valid neighbours.

    Raises:
        ObservationError: The number of beams is wrong, or no beam is valid.
    """
    filled_ranges = np.asarray(ranges, dtype=np.float32)
    if filled_ranges.shape != (layout.beams,):
        raise ObservationError(
            f"scan has {filled_ranges.size} beams: the policy takes {layout.beams}; resample it"
        )
    is_missing = np.isnan(filled_ranges)
    if not is_missing.any():
        return filled_ranges
    if is_missing.all():
        raise ObservationError(
            f"all {layout.beams} beams of the scan measure nothing: check the laser"
        )
    # Capped first, because no value can be interpolated towards infinity.
    filled_ranges = np.where(is_missing, 0.0, np.clip(filled_ranges, 0.0, layout.range_cap))
    missing_beams = np.flatnonzero(is_missing)
    valid_beams = np.flatnonzero(~is_missing)
    filled_ranges[missing_beams] = np.interp(missing_beams, valid_beams, filled_ranges[valid_beams])
    return filled_ranges


def local_goal(plan: Any, pose: Any, lookahead: float = LAYOUT.lookahead) -> Tuple[float, float]:
    """Return the local goal (gx, gy) in the robot's frame [m].

    It is the first point of the smoothed global plan farther than `lookahead` from the robot, or
    the last point of the plan if there is none.

    Args:
        plan: (n, >= 2) x, y [m] in the frame of the pose, start first.
        pose: (x, y, yaw) of the robot [m, rad].
        lookahead: Lookahead distance [m]; 1 m in the paper.

    Raises:
        ObservationError: The plan is empty, or plan or pose is not finite.
    """
    plan = np.asarray(plan, dtype=np.float64)
    if plan.ndim != 2 or len(plan) == 0:
        raise ObservationError(
            "global plan is empty: there is no local goal until the planner finds a path"
        )
    points = plan[:, :2]
    if not (np.isfinite(points).all() and np.isfinite(pose).all()):
        raise ObservationError("global plan or pose is not finite: check odometry and planner")
    offsets = smooth(points) - pose[:2]
    dx, dy = offsets[_first_beyond(offsets, lookahead)]
    goal_x, goal_y = transform_point((0.0, 0.0, -pose[2]), dx, dy)
    return float(goal_x), float(goal_y)


def _first_beyond(offsets: Array, distance: float) -> int:
    """Return the index of the first of offsets (n, 2) longer than a distance [m]; -1 for none."""
    indices_beyond = np.flatnonzero(np.hypot(*offsets.T) > distance)
    return int(indices_beyond[0]) if len(indices_beyond) else -1


def beginning(plan: Any, pose: Any, distance: float) -> Array:
    """Return the first points (k, 2) of a plan that suffice for local_goal.

    Args:
        plan: (n, >= 2) x, y [m], start first.
        pose: (x, y, yaw) of the robot [m, rad].
        distance: Largest lookahead distance for which local_goal gives the same result as on the
            whole plan [m].
    """
    points = np.asarray(plan, dtype=np.float64)[:, :2]
    index_beyond = _first_beyond(smooth(points) - pose[:2], distance)
    if index_beyond < 0:
        return points
    return points[: index_beyond + WINDOW]  # The filter looks ahead by less than WINDOW.


def goal_angle(goal: Tuple[float, float]) -> float:
    """Return the angle phi = atan2(gy, gx) in [-pi, pi] of a local goal in the robot's frame."""
    return atan2(goal[1], goal[0])


def smooth(points: Array) -> Array:
    """Apply a Savitzky-Golay filter (19, 3) along the columns of points (n, k).

    The result equals scipy.signal.savgol_filter within 1e-9 m; scipy takes 20 times as long, and a
    second to import. For fewer points than the window it shrinks to the largest odd number. Up to
    four points are not filtered.
    """
    window = min(WINDOW, len(points))
    if window % 2 == 0:
        window -= 1  # The window has a point in its middle.
    if window <= ORDER:
        return np.array(points, dtype=np.float64)
    hat_matrix = _hat(window)
    half_window = window // 2
    smoothed = np.empty(points.shape, dtype=np.float64)
    # In the middle, each point is the value of the cubic through its window. np.convolve reverses
    # the weights.
    middle_weights = hat_matrix[half_window][::-1]
    for column in range(points.shape[1]):
        middle_values = np.convolve(points[:, column], middle_weights, mode="valid")
        smoothed[half_window : len(points) - half_window, column] = middle_values
    # Near the ends, the cubics of the first and the last whole window go on (savgol_filter's mode
    # "interp").
    smoothed[:half_window] = hat_matrix[:half_window] @ points[:window]
    smoothed[-half_window:] = hat_matrix[-half_window:] @ points[-window:]
    return smoothed


@lru_cache(maxsize=None)
def _hat(window: int) -> Array:
    """Return the hat matrix (window, window) of the fit of a cubic.

    Row i has the weights of the points for the value of the cubic at point i.
    """
    x = np.arange(window, dtype=np.float64) - window // 2
    vandermonde = x[:, None] ** np.arange(ORDER + 1)
    return vandermonde @ np.linalg.pinv(vandermonde)
