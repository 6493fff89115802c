"""Simulated odometry of both simulators: distance from the wheels, heading from the IMU.

The robot_localization node of the Jackal fuses wheels and IMU in this way. The estimate does not account for lateral
slip, or for wheels that spin at an obstacle.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.robots.robot import OdometryErrors


class Odometry:
    """Dead reckoning in frame odom, with random errors."""

    def __init__(self, errors: OdometryErrors, yaw: float, rng: np.random.Generator, scale: float = 1.0) -> None:
        """Start at (0, 0, yaw). `scale` multiplies all errors."""
        self.errors, self.rng, self.scale = errors, rng, scale
        self.pose = (0.0, 0.0, yaw)
        self.twist = (0.0, 0.0)
        self.imu = (0.0, 0.0)
        self._gain = 1.0 + scale * errors.scale_error * float(rng.standard_normal())
        self._heading = yaw  # heading without the noise of a single reading [rad]
        self._error = 0.0  # slow error of the heading [rad]
        self._behind, self._rate = 0.0, 0.0  # lag of the filter behind the wheels [m], filtered yaw rate [rad/s]
        self._turned = 0.0  # rotation of frame odom relative to the world [rad]

    def set(self, pose: Tuple[float, float, float], true_yaw: float) -> None:
        """Set the pose (x, y, yaw) in frame odom, for a robot whose true yaw is `true_yaw` [rad]."""
        self.pose = (float(pose[0]), float(pose[1]), float(pose[2]))
        self._heading = self.pose[2]
        self._behind = self._rate = 0.0
        self._turned = self.pose[2] - true_yaw

    def update(self, duration: float, wheel_speed: float, yaw: float, yaw_rate: float, acceleration: float) -> None:
        """Integrate `duration` [s] at the mean wheel speed `wheel_speed` [m/s].

        The arguments yaw, yaw_rate and acceleration are the true values at the end [rad, rad/s, m/s^2].
        """
        errors, normal = self.errors, self.rng.standard_normal
        keep = exp(-duration / errors.heading_time)
        self._error = keep * self._error + self.scale * errors.heading_drift * sqrt(1.0 - keep * keep) * normal()
        x, y, old = self.pose[0], self.pose[1], self._heading
        yaw += self._error + self._turned
        turn = normalize_angle_modulo(yaw - old)
        wheel_speed *= self._gain
        ahead, seen_rate = wheel_speed * duration, yaw_rate
        if errors.lag > 0.0:  # The filter is of first order. The heading comes from the IMU and does not lag.
            keep, behind = exp(-duration / errors.lag), self._behind
            self._behind = keep * behind + (1.0 - keep) * errors.lag * wheel_speed
            ahead, wheel_speed = ahead + behind - self._behind, self._behind / errors.lag
            seen_rate = self._rate = keep * self._rate + (1.0 - keep) * yaw_rate
        middle = old + 0.5 * turn
        self._heading = normalize_angle_modulo(old + turn)
        seen = self._heading + self.scale * errors.heading_noise * normal()
        self.pose = (x + ahead * cos(middle), y + ahead * sin(middle), normalize_angle_modulo(seen))
        noise = self.scale * errors.gyro_noise * normal()
        self.twist = (wheel_speed + self.scale * errors.speed_noise * normal(), seen_rate + noise)
        self.imu = (acceleration + self.scale * errors.accelerometer_noise * normal(), yaw_rate + noise)
