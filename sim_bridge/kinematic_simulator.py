"""KinematicSimulator: the robot of the pybullet simulator without a physics engine, for training volume.

Same interface, laser, odometry, wheels and tyres; in the plane, with contacts by geometry
(kinematic_kernel.py). Its few free numbers are fitted to PybulletSimulator.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, cos, inf, sin
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.robots import Robot

from . import kinematic_kernel as kernel
from . import wheels
from .mechanics import mechanics
from .odometry import Odometry
from .simulator import RobotState, Simulator

STEP = kernel.STEP
JUMP = 10.0  # [m/s]; a moving obstacle that seems faster has gone back to where its animation starts


class KinematicSimulator(Simulator):
    """See Simulator. wheel_rub, body_rub and undo of the robot's description are fitted to PybulletSimulator."""

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any):
        super().__init__(robot, **randomisation)
        found = self._mechanics = mechanics(self.robot)
        self._constants = found.scalars, found.supports, found.parts, wheels.rim_table(self.robot)
        self._noises = wheels.noises(found.supports)
        self._friction = self.robot.base.wheel_friction

    def _place(self, pose, new_world, seed):
        self._odometry = Odometry(self.robot.odometry, pose[2], np.random.default_rng(seed), self.drawn.odometry)
        self._noise, self._angle_seed = np.random.default_rng([seed, 1]), [seed, 2]
        if new_world:
            self._stand()
        self._steps, self._elapsed = 0, 0.0
        self._move_to(pose)
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)

    def _stand(self):
        self._circles = np.zeros((len(self.world.cylinders), 5))  # x, y, radius, velocity
        self._circles[:, :3] = self.world.cylinders
        self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)

    def _move_to(self, pose):
        self._rolling = wheels.new_drive(self._mechanics.supports, self._angle_seed)
        self._body = np.zeros(kernel.SIZE)
        c, s = cos(pose[2]), sin(pose[2])
        com_x, com_y = self._mechanics.com
        self._body[:3] = pose[0] + c * com_x - s * com_y, pose[1] + s * com_x + c * com_y, pose[2]

    def set_motion(
        self, twist: Tuple[float, float, float], wheels_twist: Tuple[float, float], angles: Tuple[float, float]
    ) -> None:
        """Give the robot where it stands the motion of a recorded one.

        Args:
            twist: of base_link ahead, to the left [m/s] and its yaw rate [rad/s].
            wheels_twist: what the wheels turn for [m/s, rad/s].
            angles: of the left and right wheels [rad].
        """
        (u, s, w), (com_x, com_y) = twist, self._mechanics.com
        self._body[kernel.U], self._body[kernel.S], self._body[kernel.W] = u - w * com_y, s + w * com_x, w
        self._rolling[[wheels.RAMP_V, wheels.RAMP_W]] = wheels_twist
        self._rolling[wheels.ANGLE : wheels.ANGLE + 2] = angles
        self.state = replace(self.state, twist=(u, w))

    def _drive(self, duration):
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps <= 0:
            return
        circles = self._circles
        if self.world.movers:
            now, then = self.mover_circles(), self.mover_circles(self._steps * STEP + steps * STEP)
            velocity = (then - now)[:, :2] / (steps * STEP)
            velocity[np.hypot(*velocity.T) > JUMP] = 0.0
            circles = np.concatenate([circles, np.hstack([now, velocity])])
        ground, shape = self._ground(), (steps, self._noises)
        noise = self._noise.standard_normal(shape) if ground < 1.0 else np.zeros(shape)  # Gazebo's wheels turn evenly
        place = self._body, self._rolling, steps, self._schedule(steps), circles, self._boxes
        friction = self._friction * self.drawn.friction
        kernel.drive(*place, *self._constants, noise, friction, self.drawn.slip, ground)
        self._steps += steps
        x, y, yaw, u, s, w, rolled, contact = self._body.tolist()
        com_x, com_y = self._mechanics.com
        c, sn = cos(yaw), sin(yaw)
        u += w * com_y  # from the centre of mass to base_link
        odometry, span = self._odometry, steps * STEP
        odometry.update(span, rolled, yaw, w, (u - self.state.twist[0]) / span)
        pose = x - c * com_x + sn * com_y, y - sn * com_x - c * com_y, yaw
        self.state = RobotState(
            self._steps * STEP, pose, (u, w), odometry.pose, odometry.twist, contact > 0.0, False, odometry.imu
        )

    def _schedule(self, steps):
        """(k, 3): from which step on a velocity target holds, and the target [m/s, rad/s]."""
        start, command = self._steps, self._command
        rows = [(0, *self._target(start * STEP))]
        step, last = 0, (start + steps - 1) * STEP
        while True:  # on to the next command or the time-out
            change = command.pending[0][0] if command.pending else inf
            if (start + step) * STEP < command.until - 1e-9:
                change = min(change, command.until)
            if change - 1e-9 > last:
                return np.array(rows)
            step = max(step + 1, ceil((change - 1e-9) / STEP) - start)
            rows.append((step, *self._target((start + step) * STEP)))
