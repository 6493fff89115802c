"""Scenes for tests of the collision monitor: scans of discs, and monitors that saw them."""

import math
from dataclasses import replace

import numpy as np

from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.moving import NO_DISCS
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import (
    EVERYTHING,
    BodyOutline,
    Braking,
    Delay,
    safe_scale,
)
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.support.robots import scan_by

# Braking limits, outline and margins as the node has them for a Jackal.
SETTINGS = MonitorSettings.of(JACKAL)
BRAKES_WELL = replace(SETTINGS, deceleration=4.0, yaw_deceleration=12.0)
HERE = (0.0, 0.0, 0.0)
BEHIND = (0.0, 0.0, math.pi)
AT_REST = (0.0, 0.0)

BEAMS = 720
ANGLE = 2.35619  # bearing of the last beam [rad]
LASER = 0.12  # distance of the laser ahead of the robot's centre [m]
# Full turn of a TurtleBot3's laser, whose ends meet straight ahead.
TURN = {"angle_min": 0.0, "angle_increment": 2 * math.pi / 359}

# Body of the Jackal with its margin, and distances of its front and its side from the centre [m].
BODY = BodyOutline.of(SETTINGS.body, margin=0.03)
FRONT = 0.229
SIDE = 0.208

# 4 m/s^2 and 12 rad/s^2: with weak ones, most scenes here would be blocked.
STRONG_BRAKES = Braking(4.0, 12.0)


def scan_of(points, pose, stamp=0.0, **changes):
    """Return the scan of a Jackal among discs of 5 cm radius.

    The discs are at points (n, 2) in the odometry frame, in which the robot is at `pose`.
    """
    x, y, yaw = pose
    sensor_pose = (x + LASER * math.cos(yaw), y + LASER * math.sin(yaw), yaw)
    discs = [(*point, 0.05) for point in points]
    ranges = Lidar(JACKAL.laser, discs, np.zeros((0, 5))).scan(*sensor_pose)
    scan = scan_by(JACKAL.laser, stamp, ranges, sensor_pose)
    return replace(scan, **changes)


def across(x, right, left, spacing):
    """Return points (x, y) [m] across the robot's way, from y = right to below y = left."""
    return [(x, y) for y in np.arange(right, left, spacing)]


def wall(x, half_width=1.0):
    """Return discs across the way of the robot, whose front is 5 cm nearer than x [m]."""
    return across(x, -half_width, half_width, 0.04)


# Wall 3 cm behind the body, whose rear is at -0.229 m, less the discs' radius.
CLOSE_BEHIND = across(-0.32, -0.2, 0.21, 0.05)


def posts(seed):
    """Return random positions (n, 2) [m] of posts, none of them at the robot."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-4.0, 4.0, (40, 2))
    return places[np.hypot(*places.T) > 0.8]


def verdict_on(monitor, v, time=0.0):
    """Return the verdict on the command to drive straight at v [m/s], for a robot at rest at (0, 0,
    0).
    """
    return monitor.filter(time, HERE, AT_REST, (v, 0.0))


def seen_all_around(points, settings=None):
    """Return a monitor at (0, 0, 0) and time 0 that has looked behind and then ahead.

    Discs are at points (n, 2) [m].
    """
    monitor = CollisionMonitor(settings)
    monitor.add_scan(scan_of(points, BEHIND, -0.1))
    monitor.add_scan(scan_of(points, HERE, 0.0))
    return monitor


def safe_scale_of(
    points,
    motion,
    command,
    braking=STRONG_BRAKES,
    pose_age=0.0,
    reaction=0.15,
    body=BODY,
    seen=EVERYTHING,
    discs=NO_DISCS,
):
    """Return the safe scale of a command of the Jackal for points (n, 2) [m] and one BaseMotion."""
    safe = safe_scale(
        np.array(points, dtype=float).reshape(-1, 2),
        body,
        np.array([motion]),
        command,
        Delay(pose_age, reaction),
        braking,
        seen,
        discs,
    )
    return safe.scale
