"""KinematicSimulator: the pybullet Jackal's motion without a physics engine, for training volume.

Same interface, same laser, same odometry; lag, slip, drift and contacts are fitted to PybulletSimulator by
`python -m sim_bridge.fit`, whose result is written into KinematicParameters' defaults.
"""
from dataclasses import astuple, dataclass

import numpy as np

from . import kinematic_kernel as kernel
from .odometry import Odometry
from .simulator import RobotState, Simulator


@dataclass(frozen=True)
class KinematicParameters:
    """In the kernel's order. Fitted values: see sim_bridge/fit.py."""
    lag_v: float = 0.03            # first-order lag of the speed behind the wheels [s]
    lag_w: float = 0.03            # and of the yaw rate
    gain_v: float = 1.0            # driven / commanded, steady
    gain_w: float = 1.0
    centre: float = 0.012          # the robot turns about a point this far ahead of base_link [m]
    skew: float = 0.0              # sideways speed per yaw rate, whichever way it turns [m]
    drop: float = 0.0              # share of the speed lost per rad/s of turning
    slip_u: float = 0.03           # correlated slip, standard deviations: of the speed,
    slip_s: float = 0.01           # sideways per yaw rate [m],
    slip_w: float = 0.03           # of the yaw rate
    slip_time: float = 0.5         # correlation time [s]
    give_y: float = 0.8            # how easily a contact moves the body aside (ahead: 1)
    give_w: float = 12.0           # and turns it [1/m^2]
    rub: float = 0.3               # friction along a touched surface
    regain: float = 1.0            # share of the velocity lost at a contact


class KinematicSimulator(Simulator):
    """See Simulator. `parameters` replaces the fitted Jackal by another robot."""

    def __init__(self, parameters=KinematicParameters(), **randomisation):
        super().__init__(**randomisation)
        self.parameters = parameters

    def _place(self, pose, new_world, seed):
        rng = np.random.default_rng(seed)
        self._noise = rng.spawn(1)[0] if hasattr(rng, "spawn") else np.random.default_rng(seed + 1)
        self._odometry = Odometry(pose[2], rng)
        if new_world:
            self._circles = np.ascontiguousarray(self.world.cylinders, dtype=np.float64).reshape(-1, 3)
            self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)
        self._steps = 0
        self._elapsed = 0.0
        self._body = np.zeros(kernel.SIZE)
        self._body[:3] = pose
        values = np.array(astuple(self.parameters), dtype=np.float64)
        values[7:10] *= self.drawn.slip
        self._values = values
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)

    def _drive(self, duration):
        self._elapsed += duration
        steps = int(round(self._elapsed / kernel.STEP)) - self._steps
        if steps <= 0:
            return
        times, targets = self._schedule(steps)
        circles = self._circles
        if self.world.movers:
            circles = np.concatenate([circles, self.mover_circles()])
        kernel.drive(self._body, steps, times, targets, circles, self._boxes, self._values,
                     self._noise.standard_normal((steps, 3)), self.drawn.friction)
        self._steps += steps
        body = self._body
        time = self._steps * kernel.STEP
        yaw, u, w = float(body[kernel.YAW]), float(body[kernel.U]), float(body[kernel.W])
        odometry = self._odometry
        odometry.update(steps * kernel.STEP, float(body[kernel.WHEEL_V]), yaw, w, float(body[kernel.ACCEL]))
        self.state = RobotState(time, (float(body[kernel.X]), float(body[kernel.Y]), yaw), (u, w), odometry.pose,
                                odometry.twist, bool(body[kernel.CONTACT]), False, odometry.imu)

    def _schedule(self, steps):
        """The velocity target of each step, as (from which step, (v, w)), where it changes."""
        times, targets = [], []
        start = self._steps * kernel.STEP
        for step in range(steps):
            target = self._target(start + step * kernel.STEP)
            if not targets or target != targets[-1]:
                times.append(step)
                targets.append(target)
        return np.array(times), np.array(targets)
