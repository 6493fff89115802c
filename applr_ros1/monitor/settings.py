"""Settings of the collision monitor for a base, with range checks."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from applr_ros1.common.arguments import number_within
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import corners
from applr_ros1.robots.robot import Monitoring

# Settings that describe the robot, and are no parameters of the monitor
OF_ROBOT = {"body", "max_speed", "max_yaw_rate", "scan_period"}


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of the monitor for a base.

    Attributes:
        body: convex outline of all parts that can touch an obstacle, (x, y) [m] in the robot's
            frame.
        margin: distance to keep from every obstacle point [m].
        reaction_time: time from a command until the base follows the next one, control period plus
            latency [s]. The monitor adds the measured ages of scan, pose and twist.
        deceleration: guaranteed braking deceleration [m/s^2].
        yaw_deceleration: guaranteed deceleration of the turn rate [rad/s^2].
        turn_gain: largest ratio of actual to commanded turn rate.
        turn_ahead: distance from the robot's origin forward to its centre of rotation [m].
        max_speed: fastest speed of the base [m/s].
        max_yaw_rate: fastest turn rate of the base [rad/s].
        scan_period: interval between two scans [s].
        creep_speed: fastest speed of any point of the body in unobserved space [m/s].
        mover_acceleration: largest acceleration of a tracked moving obstacle [m/s^2].
        passive_safety: whether the base must stand before a tracked moving obstacle touches it.
        scan_timeout: age of the latest scan, pose or twist at which the base must stop [s].
        memory_radius: distance within which obstacles are remembered [m].
        memory_seconds: time for which an obstacle out of the scanner's sight is remembered [s]. It
            must exceed the time that a blocked robot waits. Lower it only if obstacles often move
            away behind the robot.
    """

    body: Tuple[Tuple[float, float], ...]
    margin: float
    reaction_time: float
    deceleration: float
    yaw_deceleration: float
    max_speed: float
    max_yaw_rate: float
    scan_period: float
    turn_gain: float = 1.0
    turn_ahead: float = 0.0
    creep_speed: float = 0.1
    mover_acceleration: float = 1.0
    passive_safety: bool = True
    scan_timeout: float = 0.5
    memory_radius: float = 8.0
    memory_seconds: float = 300.0

    @classmethod
    def of(cls, robot: Robot) -> "MonitorSettings":
        """Return a robot's settings: its outline, in whole millimetres, and section `monitor`.

        Speeds and scan period are those of its base and its laser.
        """
        outline = corners(robot)
        # Coordinates that rounding errors put just above a whole millimetre are not rounded up to
        # the next one.
        millimetres = np.ceil(1e3 * np.abs(outline) - 1e-6)
        body = np.copysign(millimetres / 1e3, outline)
        return cls(
            body=tuple((x, y) for x, y in body.tolist()),
            max_speed=robot.base.max_speed,
            max_yaw_rate=robot.base.max_yaw_rate,
            scan_period=1.0 / robot.laser.rate,
            **robot.monitor.model_dump(),
        )

    def __post_init__(self) -> None:
        bounds = {
            "scan_timeout": (0.01, 10.0),
            "memory_radius": (0.1, 100.0),
            "memory_seconds": (0.0, 1e6),
        }
        for name, field in Monitoring.model_json_schema()["properties"].items():
            if field["type"] == "number":
                bounds[name] = (field["minimum"], field["maximum"])
        for name, (low, high) in bounds.items():
            number_within(f"collision monitor: {name}", getattr(self, name), low, high)
