"""KinematicSimulator: the pybullet Jackal without a physics engine, for training volume.

Same interface, laser, odometry, wheels and tyres; in the plane, with contacts by geometry
(kinematic_kernel.py). Its few free numbers are fitted to PybulletSimulator by `python -m sim_bridge.fit_kinematic`.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import cos, sin
from typing import Any, List, Tuple

import numpy as np

from . import jackal, skid_steer
from . import kinematic_kernel as kernel
from .odometry import Odometry
from .simulator import RobotState, Simulator

STEP = kernel.STEP
JUMP = 10.0  # [m/s]; a moving obstacle that seems faster has gone back to where its animation starts


@dataclass(frozen=True)
class KinematicParameters:
    """In the kernel's order; sim_bridge/fit_kinematic.py prints the fitted values that stand here."""

    wheel_rub: float = 0.66  # friction of a wheel along an obstacle
    chassis_rub: float = 0.94  # and of the chassis
    undo: float = 0.51  # share of an overlap that is undone in a step


class KinematicSimulator(Simulator):
    """See Simulator. `parameters` replaces the fitted Jackal by another robot."""

    def __init__(self, parameters: KinematicParameters = KinematicParameters(), **randomisation: Any):
        super().__init__(**randomisation)
        self.parameters = np.array(astuple(parameters), dtype=np.float64)
        self._table = skid_steer.rim_table()

    def _place(self, pose, new_world, seed):
        self._odometry = Odometry(pose[2], np.random.default_rng(seed))
        self._noise = np.random.default_rng([seed, 1])
        if new_world:
            self._circles = np.zeros((len(self.world.cylinders), 5))  # x, y, radius, velocity
            self._circles[:, :3] = self.world.cylinders
            self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)
        self._steps, self._elapsed = 0, 0.0
        self._move_to(pose)
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)

    def _move_to(self, pose):
        self._wheels = np.zeros(skid_steer.SIZE)
        self._body = np.zeros(kernel.SIZE)
        c, s = cos(pose[2]), sin(pose[2])
        com_x, com_y = jackal.COM
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
        kernel.drive(
            self._body,
            self._wheels,
            steps,
            times,
            targets,
            circles,
            self._boxes,
            self._table,
            self.parameters,
            self._noise.standard_normal((steps, skid_steer.NOISES)),
            jackal.WHEEL_FRICTION * self.drawn.friction,
            self.drawn.slip,
        )
        self._steps += steps
        x, y, yaw, u, s, w, rolled, contact = self._body.tolist()
        com_x, com_y = jackal.COM
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
