"""Simulated odometry of both simulators: distance from the wheels, heading from the IMU.

The robot_localization node of the Jackal fuses wheels and IMU in this way. The estimate does not
account for lateral slip, or for wheels that spin at an obstacle.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.robots.robot import OdometryErrors


class Odometry:
    """Dead reckoning in frame odom, with random errors."""

    def __init__(
        self, errors: OdometryErrors, yaw: float, rng: np.random.Generator, scale: float = 1.0
    ) -> None:
        """Start at (0, 0, yaw). `scale` multiplies all errors."""
        self.errors = errors
        self.rng = rng
        self.scale = scale
        self.pose = (0.0, 0.0, yaw)
        self.twist = (0.0, 0.0)
        self.imu = (0.0, 0.0)
        self._gain = 1.0 + scale * errors.scale_error * float(rng.standard_normal())
        self._heading = yaw  # heading without the noise of a single reading [rad]
        self._error = 0.0  # slow error of the heading [rad]
        self._behind = 0.0  # lag of the filter behind the wheels [m]
        self._rate = 0.0  # filtered yaw rate [rad/s]
        self._turned = 0.0  # rotation of frame odom relative to the world [rad]

    def place(self, pose: Tuple[float, float, float], true_yaw: float) -> None:
        """Set the pose (x, y, yaw) in frame odom of a robot whose true yaw is `true_yaw` [rad]."""
        self.pose = (float(pose[0]), float(pose[1]), float(pose[2]))
        self._heading = self.pose[2]
        self._behind = 0.0
        self._rate = 0.0
        self._turned = self.pose[2] - true_yaw

    def integrate(
        self, duration: float, wheel_speed: float, yaw: float, yaw_rate: float, acceleration: float
    ) -> None:
        """Integrate one step of dead reckoning.

        Args:
            duration: Duration of the step [s].
            wheel_speed: Mean speed of the wheels [m/s].
            yaw: True yaw at the end of the step [rad].
            yaw_rate: True yaw rate at the end [rad/s].
            acceleration: True forward acceleration [m/s^2].
        """
        errors = self.errors
        scale = self.scale
        normal = self.rng.standard_normal
        # Slow error of the heading, of first order: its standard deviation stays heading_drift.
        keep = exp(-duration / errors.heading_time)
        drift = scale * errors.heading_drift * sqrt(1.0 - keep * keep) * normal()
        self._error = keep * self._error + drift
        turn = normalize_angle_modulo(yaw + (self._error + self._turned) - self._heading)

        # Distance and yaw rate lag by the first-order filter that fuses wheels and IMU. The heading
        # comes from the IMU and does not lag.
        wheel_speed *= self._gain
        distance = wheel_speed * duration
        seen_speed = wheel_speed
        seen_rate = yaw_rate
        if errors.lag > 0.0:
            keep = exp(-duration / errors.lag)
            lag_distance = keep * self._behind + (1.0 - keep) * errors.lag * wheel_speed
            distance = distance + self._behind - lag_distance
            self._behind = lag_distance
            seen_speed = lag_distance / errors.lag
            self._rate = keep * self._rate + (1.0 - keep) * yaw_rate
            seen_rate = self._rate

        # The robot drives along an arc, whose chord has the mean of both headings.
        middle_heading = self._heading + 0.5 * turn
        self._heading = normalize_angle_modulo(self._heading + turn)
        seen_yaw = normalize_angle_modulo(self._heading + scale * errors.heading_noise * normal())
        x = self.pose[0] + distance * cos(middle_heading)
        y = self.pose[1] + distance * sin(middle_heading)
        self.pose = (x, y, seen_yaw)
        gyro_noise = scale * errors.gyro_noise * normal()
        speed_noise = scale * errors.speed_noise * normal()
        self.twist = (seen_speed + speed_noise, seen_rate + gyro_noise)
        accelerometer_noise = scale * errors.accelerometer_noise * normal()
        self.imu = (acceleration + accelerometer_noise, yaw_rate + gyro_noise)
