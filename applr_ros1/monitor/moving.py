"""Discs that moving obstacles may occupy until the base stands, for the collision monitor.

Passive safety (Macek, Vasquez, Fraichard and Siegwart, "Safe vehicle navigation in dynamic urban
scenarios", ITSC 2008): whatever the others do within what is assumed of them, the base rests before
a contact. A tracked obstacle is assumed to keep its velocity, known up to the tracker's covariance,
and to change it by no more than an acceleration. It is a disc that grows. stopping.py compares it
with the body, time for time.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_motions, transform_point
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan, beam_directions
from applr_ros1.movers.tracker import Movers

# Standard deviations of a tracked position by which its disc is larger. Half of the filter's
# deviation, 0.08 m/s, is more than the median error that was measured for the Jackal.
DEVIATIONS = 0.5
ON_MOVER_M = 0.2  # distance from a tracked disc within which a range ends on it [m]
# Time after a stop for which the base should stand out of the way of what moves, and step of the
# check
AHEAD_S = 1.4
AHEAD_STEP_S = 0.1
AHEAD_STEPS = round(AHEAD_S / AHEAD_STEP_S)

# x, y: centre [m], in the robot's frame at its latest pose. vx, vy: velocity [m/s].
# radius [m]. pp, pv, vv: variance of the position, covariance of position and velocity, variance of
#     the velocity, along each axis.
# acceleration: largest change of the velocity [m/s^2]. age: age of the disc at the time of the
#     pose [s].
DISC = np.dtype(
    [
        ("x", np.float64),
        ("y", np.float64),
        ("vx", np.float64),
        ("vy", np.float64),
        ("radius", np.float64),
        ("pp", np.float64),
        ("pv", np.float64),
        ("vv", np.float64),
        ("acceleration", np.float64),
        ("age", np.float64),
    ],
    align=True,
)
Disc = Any  # a record of DISC, which numba knows by its dtype
Discs = Any  # an array (n,) of them
NO_DISCS = np.empty(0, DISC)


class BodyPose(NamedTuple):
    """Pose of the body: x, y [m], cosine and sine of its yaw."""

    x: float
    y: float
    cos_yaw: float
    sin_yaw: float


def tracked_discs(
    movers: Movers, planes: Array, robot_pose: Pose, age: float, acceleration: float
) -> Discs:
    """Return the DISCs (n,) of tracked obstacles.

    Args:
        movers: Tracked obstacles in the frame of the pose.
        planes: (k, 3) half planes of the robot's outline. What the laser sees in the middle of it
            is a part of the robot, and has no disc.
        robot_pose: Pose (x, y, yaw) of the robot.
        age: Time from the scan of the tracked obstacles to this pose [s].
        acceleration: Largest change of their velocities [m/s^2].
    """
    motions = np.column_stack([movers.x, movers.y, movers.vx, movers.vy])
    # The columns are the fields of DISC, in their order.
    discs = np.zeros((len(motions), len(DISC.names or ())))
    discs[:, :4] = transform_motions(inverse(robot_pose), motions)
    discs[:, 4] = movers.radius
    discs[:, 5:8] = movers.covariance
    discs[:, 8] = acceleration
    discs[:, -1] = age
    depths = planes[:, 2] - discs[:, :2] @ planes[:, :2].T
    return discs.view(DISC)[depths.min(axis=1) < 0.0, 0]


def without_movers(scan: LaserScan, movers: Movers) -> LaserScan:
    """Return a scan without the ranges that end on tracked obstacles, which become NaN.

    Otherwise what moves past a robot would look as if the robot slid.
    """
    if not len(movers.x):
        return scan
    directions = beam_directions(scan.angle_min, scan.angle_increment, len(scan.ranges))
    x, y = transform_point(inverse(scan.sensor_pose), movers.x, movers.y)
    discs = np.column_stack([x, y, movers.radius + ON_MOVER_M])
    ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
    return replace(scan, ranges=_without_discs(ranges, directions, discs))


def warm_up(scan: LaserScan) -> None:
    """Compile or load the kernel that runs only once something moves."""
    ones = np.ones(1)
    without_movers(scan, Movers(ones, ones, ones, ones, ones, ones, np.ones((1, 3)), ones > 0.0))


@kernel
def _without_discs(ranges: Array32, directions: Array, discs: Array) -> Array32:
    """Return ranges (n,) [m], with NaN for those that end within discs.

    Args:
        ranges: (n,) [m].
        directions: (n, 2) cosine and sine of each beam.
        discs: (k, 3) x, y and radius [m] in the laser's frame.
    """
    kept_ranges = ranges.copy()
    for beam in range(ranges.shape[0]):
        if not np.isfinite(ranges[beam]):
            continue
        end_x = ranges[beam] * directions[beam, 0]
        end_y = ranges[beam] * directions[beam, 1]
        for disc in range(discs.shape[0]):
            apart_x = end_x - discs[disc, 0]
            apart_y = end_y - discs[disc, 1]
            if apart_x * apart_x + apart_y * apart_y < discs[disc, 2] ** 2:
                kept_ranges[beam] = np.nan
    return kept_ranges


@kernel
def may_meet(
    discs: Discs, planes: Array, edge: Array, margin: float, place: BodyPose, time: float
) -> bool:
    """Return whether a body may meet a disc at a time, wherever the disc may be by then.

    Args:
        discs: (n,) DISCs.
        planes: (k, 3) half planes of the body's outline.
        edge: (n, 2) points along it [m].
        margin: distance by which the outline is widened [m].
        place: place of the body at this time.
        time: time since the robot's latest pose [s].
    """
    for disc in discs:
        elapsed = max(time + disc.age, 0.0)
        reach = margin + _radius_after(disc, elapsed)
        if _is_within(disc, planes, edge, place, elapsed, reach):
            return True
    return False


@kernel
def will_meet(
    discs: Discs, planes: Array, edge: Array, margin: float, place: BodyPose, time: float
) -> bool:
    """Return whether a body that stands from a time on meets a disc that keeps its velocity.

    The arguments are those of may_meet. Discs count for AHEAD_S.
    """
    for disc in discs:
        reach = margin + disc.radius
        for step in range(AHEAD_STEPS + 1):  # Both ends of the time count.
            elapsed = max(time + step * AHEAD_STEP_S + disc.age, 0.0)
            if _is_within(disc, planes, edge, place, elapsed, reach):
                return True
    return False


@kernel
def _is_within(
    disc: Disc, planes: Array, edge: Array, place: BodyPose, elapsed: float, reach: float
) -> bool:
    """Return whether a disc's centre is nearer to a body than `reach` [m] after a time [s]."""
    offset_x = disc.x + disc.vx * elapsed - place.x
    offset_y = disc.y + disc.vy * elapsed - place.y
    forward = place.cos_yaw * offset_x + place.sin_yaw * offset_y
    leftward = place.cos_yaw * offset_y - place.sin_yaw * offset_x

    # The distance from the outline is at least that from the farthest of its half planes.
    lowest_distance = -np.inf
    for plane in range(planes.shape[0]):
        extent = planes[plane, 0] * forward + planes[plane, 1] * leftward
        lowest_distance = max(lowest_distance, extent - planes[plane, 2])
        if lowest_distance >= reach:
            return False
    if lowest_distance <= 0.0:
        return True
    for point in range(edge.shape[0]):
        apart_x = edge[point, 0] - forward
        apart_y = edge[point, 1] - leftward
        if apart_x * apart_x + apart_y * apart_y < reach * reach:
            return True
    return False


@kernel
def _radius_after(disc: Disc, elapsed: float) -> float:
    """Return the radius [m] within which an obstacle is after a time [s]."""
    variance = disc.pp + 2.0 * elapsed * disc.pv + elapsed * elapsed * disc.vv
    uncertainty = DEVIATIONS * math.sqrt(variance)
    swerve = 0.5 * disc.acceleration * elapsed * elapsed
    return float(disc.radius + uncertainty + swerve)
