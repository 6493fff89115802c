"""Settings of the collision monitor for a base, checked."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from applr_ros1.common.arguments import number_within
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import corners
from applr_ros1.robots.robot import Monitoring


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of the monitor for a base.

    Attributes:
        body: convex outline of everything that can touch an obstacle, (x, y) [m] in the robot's frame.
        margin: distance kept from every obstacle point [m].
        reaction_time: from a command until the base follows the next one [s]: control period and latency. The ages of
            scan, pose and twist, which the monitor measures, come on top.
        deceleration: braking on which one can rely [m/s^2].
        yaw_deceleration: the same of the turn rate [rad/s^2].
        turn_gain: how many times as fast as commanded the base may turn.
        turn_ahead: how far [m] ahead of the robot's origin the point lies about which it turns.
        creep_speed: fastest speed of any point of the body [m/s] in space that no scan has shown.
        scan_timeout: age of the newest scan, pose or twist at which the base must stand [s].
        memory_radius: distance within which obstacles are remembered [m].
        memory_seconds: how long an obstacle is remembered that the scanner does not see any more [s]. A robot that
            waits blocked must not outwait it: give less only where obstacles walk away behind the robot.
    """

    body: Tuple[Tuple[float, float], ...]
    margin: float
    reaction_time: float
    deceleration: float
    yaw_deceleration: float
    turn_gain: float = 1.0
    turn_ahead: float = 0.0
    creep_speed: float = 0.1
    scan_timeout: float = 0.5
    memory_radius: float = 8.0
    memory_seconds: float = 300.0

    @classmethod
    def of(cls, robot: Robot) -> "MonitorSettings":
        """Return those of a robot's description: its outline, rounded up to millimetres, and its section `monitor`."""
        outline = corners(robot)
        body = np.copysign(np.ceil(1e3 * np.abs(outline) - 1e-6) / 1e3, outline)
        return cls(body=tuple((x, y) for x, y in body.tolist()), **robot.monitor.model_dump())

    def __post_init__(self):
        bounds = dict(scan_timeout=(0.01, 10.0), memory_radius=(0.1, 100.0), memory_seconds=(0.0, 1e6))
        for name, field in Monitoring.model_fields.items():
            bounds[name] = tuple(getattr(m, key) for key in ("ge", "le") for m in field.metadata if hasattr(m, key))
        for name, (low, high) in bounds.items():
            number_within(f"collision monitor: {name}", getattr(self, name), low, high)
