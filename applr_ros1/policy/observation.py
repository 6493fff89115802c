"""Observation of the paper: s = (o_t, phi_t, theta_{t-1}) (section III-B), with all entries in [-1, 1].

The applr node, the learning environment and the bag reader call `observe`, so that all three use the same vector.
"""

from functools import lru_cache
from math import atan2, cos, pi, sin
from typing import Any, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.policy.layout import Layout, ObservationError
from applr_ros1.policy.parameter_space import SPACE, Space
from applr_ros1.robots import Robot

MOST_BEAMS = 720  # largest number of beams in a default layout, as in the paper
RANGE_CAP_M = 2.0  # range cap of the paper's scan at the Jackal's scale [m]
LOOKAHEAD_M = 1.0  # lookahead distance of the paper's local goal at the Jackal's scale [m]
FARTHEST_M = 4.0  # longest lookahead distance of all encodings at the Jackal's scale [m]
WINDOW, ORDER = 19, 3  # window [points] and order of the Savitzky-Golay filter that smooths the plan


@lru_cache(maxsize=32)
def layout_of(robot: Robot) -> Layout:
    """Return the default layout of new policies for a robot.

    The beams are symmetric about straight ahead: those that the laser has in such a sector, but at most MOST_BEAMS.
    Range cap and lookahead are the paper's 2 m and 1 m times the scale of the robot's worlds.
    """
    laser, scale = robot.laser, robot.world_scale
    step = laser.increment
    beams = min(laser.beams, MOST_BEAMS)
    first, last = laser.first_angle + laser.pose[2], laser.last_angle + laser.pose[2]
    if last - first + 1.5 * step >= 2.0 * pi:
        half = pi - pi / beams
    else:
        half = min(-first, last)
        if half <= step:
            raise ObservationError(f"robot {robot.name}: its laser covers {first:.3f} to {last:.3f} rad, not ahead")
        beams = min(MOST_BEAMS, int(round(2.0 * half / step)) + 1)
    return Layout(beams, -half, half, RANGE_CAP_M * scale, LOOKAHEAD_M * scale)


LAYOUT = layout_of(robots.JACKAL)  # 720 beams over 270 degrees, capped at 2 m


def observe(ranges: Any, phi: float, theta_prev: Any, space: Space = SPACE, layout: Layout = LAYOUT) -> Array32:
    """Return the observation (beams + 1 + k,) float32: capped scan, phi / pi and scaled theta_prev, in [-1, 1].

    The Jackal's observation has 720 ranges r [m], capped at 2 m and scaled to r - 1, one angle and eight parameters.

    Args:
        ranges: (beams,) [m] from layout.resample. By REP 117 +inf is no return (the cap) and -inf is too near (0 m).
            NaN is no measurement and is interpolated between its valid neighbours.
        phi: Angle of the local goal [rad].
        theta_prev: (n,) current parameters of the planner. Values outside their bounds are clipped.
        space: Parameter space of n parameters. The observation has only the k that the policy sets (space.chosen).
        layout: Layout of the scan.

    Raises:
        ObservationError: The number of beams is wrong, no beam is valid, or phi is not finite.
    """
    beams, cap = layout.beams, layout.range_cap
    ranges = without_gaps(ranges, layout)
    if not np.isfinite(phi):
        raise ObservationError(f"angle of the local goal is {phi}: check the pose and the global plan")
    chosen = space.chosen.to_action(space.pick(theta_prev))
    result = np.empty(beams + 1 + len(chosen), dtype=np.float32)
    result[:beams] = np.clip(ranges, 0.0, cap) * (2.0 / cap) - 1.0
    result[beams] = np.clip(phi / pi, -1.0, 1.0)
    result[beams + 1 :] = chosen
    return result


def without_gaps(ranges: Any, layout: Layout = LAYOUT) -> Array32:
    """Return ranges (beams,) float32 [m] in which NaN (no measurement) is interpolated between valid neighbours.

    Raises:
        ObservationError: The number of beams is wrong, or no beam is valid.
    """
    filled: Array32 = np.asarray(ranges, dtype=np.float32)
    if filled.shape != (layout.beams,):
        raise ObservationError(f"scan has {filled.size} beams: the policy takes {layout.beams}; resample it")
    missing = np.isnan(filled)
    if missing.any():
        if missing.all():
            raise ObservationError(f"all {layout.beams} beams of the scan are NaN or 0: check the laser")
        index = np.arange(layout.beams)
        filled = np.where(missing, 0.0, np.clip(filled, 0.0, layout.range_cap))
        filled[missing] = np.interp(index[missing], index[~missing], filled[~missing])
    return filled


def local_goal(plan: Any, pose: Any, lookahead: float = LAYOUT.lookahead) -> Tuple[float, float]:
    """Return the local goal (gx, gy) in the robot's frame [m].

    It is the first point of the smoothed global plan farther than `lookahead` from the robot, or the last point of the
    plan if there is none.

    Args:
        plan: (n, >= 2) x, y [m] in the frame of the pose, start first.
        pose: (x, y, yaw) of the robot [m, rad].
        lookahead: Lookahead distance [m]; 1 m in the paper.

    Raises:
        ObservationError: The plan is empty, or plan or pose is not finite.
    """
    plan = np.asarray(plan, dtype=np.float64)
    if plan.ndim != 2 or len(plan) == 0:
        raise ObservationError("global plan is empty: there is no local goal until the planner finds a path")
    if not (np.all(np.isfinite(plan[:, :2])) and np.all(np.isfinite(pose))):
        raise ObservationError("global plan or pose is not finite: check odometry and planner")
    points = smooth(plan[:, :2])
    dx, dy = points[:, 0] - pose[0], points[:, 1] - pose[1]
    far = np.flatnonzero(np.hypot(dx, dy) > lookahead)
    i = far[0] if len(far) else len(points) - 1
    c, s = cos(pose[2]), sin(pose[2])
    return float(c * dx[i] + s * dy[i]), float(-s * dx[i] + c * dy[i])


def beginning(plan: Any, pose: Any, distance: float) -> Array:
    """Return the first points (k, 2) of a plan that suffice for local_goal.

    Args:
        plan: (n, >= 2) x, y [m], start first.
        pose: (x, y, yaw) of the robot [m, rad].
        distance: Largest lookahead distance for which local_goal gives the same result as on the whole plan [m].
    """
    points = np.asarray(plan, dtype=np.float64)[:, :2]
    far = np.flatnonzero(np.hypot(*(smooth(points) - pose[:2]).T) > distance)
    return points[: far[0] + WINDOW] if len(far) else points


def goal_angle(goal: Tuple[float, float]) -> float:
    """Return the angle phi = atan2(gy, gx) in [-pi, pi] of a local goal in the robot's frame."""
    return atan2(goal[1], goal[0])


def smooth(points: Array) -> Array:
    """Apply a Savitzky-Golay filter (19, 3) along the columns of points (n, k).

    The result equals scipy.signal.savgol_filter within 1e-9 m; scipy takes 20 times as long, and a second to import.
    For fewer points than the window it shrinks to the largest odd number. Up to four points are not filtered.
    """
    window = min(WINDOW, len(points) if len(points) % 2 else len(points) - 1)
    if window <= ORDER:
        return np.array(points, dtype=np.float64)
    hat, half = _hat(window), window // 2
    result = np.empty(points.shape, dtype=np.float64)
    for k in range(points.shape[1]):
        result[half : len(points) - half, k] = np.convolve(points[:, k], hat[half][::-1], mode="valid")
    result[:half] = hat[:half] @ points[:window]
    result[-half:] = hat[-half:] @ points[-window:]
    return result


@lru_cache(maxsize=None)
def _hat(window: int) -> Array:
    """Return the hat matrix (window, window): row i has the weights of the points for the fitted cubic at point i."""
    x = np.arange(window, dtype=np.float64) - window // 2
    vandermonde: Array = x[:, None] ** np.arange(ORDER + 1)
    return vandermonde @ np.linalg.pinv(vandermonde)
