"""KinematicSimulator: the robot of the pybullet simulator without a physics engine, for training volume.

Same interface, laser, odometry, wheels and tyres; in the plane, with contacts by geometry
(kinematic_kernel.py). Its few free numbers are fitted to PybulletSimulator by `python -m sim_bridge.fit_kinematic`.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import cos, sin
from typing import Any, List, Optional, Tuple

import numpy as np

from applr_ros1.robots import Robot

from . import kinematic_kernel as kernel
from . import wheels
from .mechanics import mechanics
from .odometry import Odometry
from .simulator import RobotState, Simulator

STEP = kernel.STEP
JUMP = 10.0  # [m/s]; a moving obstacle that seems faster has gone back to where its animation starts


@dataclass(frozen=True)
class KinematicParameters:
    """In the kernel's order; sim_bridge/fit_kinematic.py fits them, and robot.yaml holds them."""

    wheel_rub: float  # friction of a wheel along an obstacle
    body_rub: float  # and of the body
    undo: float  # share of an overlap that is undone in a step

    @classmethod
    def of(cls, robot: Robot) -> KinematicParameters:
        """Those that the description of a robot holds."""
        fitted = robot.simulation
        return cls(fitted.wheel_rub, fitted.body_rub, fitted.undo)


class KinematicSimulator(Simulator):
    """See Simulator. `parameters` replaces those of the robot's description."""

    def __init__(
        self, robot: Optional[Robot] = None, parameters: Optional[KinematicParameters] = None, **randomisation: Any
    ):
        super().__init__(robot, **randomisation)
        self.parameters = np.array(astuple(parameters or KinematicParameters.of(self.robot)), dtype=np.float64)
        self._mechanics = mechanics(self.robot)
        self._table = wheels.rim_table(self.robot)

    def _place(self, pose, new_world, seed):
        self._odometry = Odometry(self.robot.odometry, pose[2], np.random.default_rng(seed))
        self._noise = np.random.default_rng([seed, 1])
        if new_world:
            self._circles = np.zeros((len(self.world.cylinders), 5))  # x, y, radius, velocity
            self._circles[:, :3] = self.world.cylinders
            self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)
        self._steps, self._elapsed = 0, 0.0
        self._move_to(pose)
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)

    def _move_to(self, pose):
        self._rolling = wheels.new_drive(self._mechanics.supports)
        self._body = np.zeros(kernel.SIZE)
        c, s = cos(pose[2]), sin(pose[2])
        com_x, com_y = self._mechanics.com
        self._body[:3] = pose[0] + c * com_x - s * com_y, pose[1] + s * com_x + c * com_y, pose[2]

    def _drive(self, duration):
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps <= 0:
            return
        times, targets = self._schedule(steps)
        circles = self._circles
        if self.world.movers:
            now, then = self.mover_circles(), self.mover_circles(self._steps * STEP + steps * STEP)
            velocity = (then - now)[:, :2] / (steps * STEP)
            velocity[np.hypot(*velocity.T) > JUMP] = 0.0
            circles = np.concatenate([circles, np.hstack([now, velocity])])
        robot = self._mechanics
        kernel.drive(
            self._body,
            self._rolling,
            steps,
            times,
            targets,
            circles,
            self._boxes,
            robot.scalars,
            robot.supports,
            robot.parts,
            self._table,
            self.parameters,
            self._noise.standard_normal((steps, wheels.noises(robot.supports))),
            self.robot.base.wheel_friction * self.drawn.friction,
            self.drawn.slip,
        )
        self._steps += steps
        x, y, yaw, u, s, w, rolled, contact = self._body.tolist()
        com_x, com_y = robot.com
        c, sn = cos(yaw), sin(yaw)
        u += w * com_y  # from the centre of mass to base_link
        odometry, span = self._odometry, steps * STEP
        odometry.update(span, rolled, yaw, w, (u - self.state.twist[0]) / span)
        pose = x - c * com_x + sn * com_y, y - sn * com_x - c * com_y, yaw
        self.state = RobotState(
            self._steps * STEP, pose, (u, w), odometry.pose, odometry.twist, contact > 0.0, False, odometry.imu
        )

    def _schedule(self, steps):
        """The velocity target of each step, as (from which step, (v, w)), where it changes."""
        times: List[int] = []
        targets: List[Tuple[float, float]] = []
        start = self._steps
        for step in range(steps):
            target = self._target((start + step) * STEP)
            if not targets or target != targets[-1]:
                times.append(step)
                targets.append(target)
        return np.array(times), np.array(targets)
