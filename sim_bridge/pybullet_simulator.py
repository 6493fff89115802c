"""Simulator with Bullet's physics at 240 Hz, PybulletSimulator, a replacement for Gazebo.

Bullet computes the support of the wheels and the contacts with obstacles, and wheels.py the friction of the tyres on
the ground. Any number of simulators may run in one process, without a window. Results are reproducible for a seed.
"""

from __future__ import annotations

from math import atan2, dist
from typing import Any, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.robots import Robot
from worlds import Mover

from . import bullet_scene as scene
from . import mechanics as m
from . import wheels
from .mechanics import STEP
from .simulator import RobotState, Simulator

Pair = Tuple[float, float]
Surface = Tuple[float, float, float, Array]  # slip, friction, ground and lift, as for wheels.tyres()
# position (3) [m], quaternion (4), velocity (2) [m/s] and yaw rate [rad/s] of the body's centre of mass
Motion = Tuple[float, float, float, float, float, float, float, float, float, float]
_CLOSING_M_S = 20.0  # largest closing speed of a moving obstacle and the robot [m/s]
_MARGIN_M = 0.1  # distance above which two bodies have no contact, Bullet's margin and penetration included [m]


class PybulletSimulator(Simulator):
    """Simulated robot in Bullet; see Simulator."""

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any) -> None:
        super().__init__(robot, **randomisation)
        self._p = scene.connect()
        self._mechanics = m.mechanics(self.robot)
        self._table = wheels.rim_table(self.robot)
        self._lift = np.ones(len(self._mechanics.supports))
        self._span = float(self._mechanics.scalars[m.REACH]) + _MARGIN_M
        self._spin_step = 0.01 * self.robot.base.max_speed  # smallest change of rim speeds passed to Bullet [m/s]

    def close(self) -> None:
        """Disconnect from Bullet, as garbage collection would. Further calls have no effect."""
        self._p = None

    def _place(self, pose: Pose, new_world: bool) -> None:
        # The scene is rebuilt every time, because Bullet keeps contacts and solver state over a change of position.
        scene.clear(self._p, STEP)
        self._obstacles, self._circles = scene.build_obstacles(self._p, self.world)
        self._near = np.zeros(len(self._obstacles), np.bool_)
        self._movers = [scene.add_mover(self._p, mover) for mover in self.world.movers]
        self._body = scene.build_robot(self._p, self.robot, pose)
        self._stop_wheels()

    def _move_to(self, pose: Pose) -> None:
        scene.put_robot(self._p, self._body, self.robot, pose)
        self._stop_wheels()

    def _stop_wheels(self) -> None:
        self._drive_state = wheels.new_drive(self._mechanics.supports, self._angle_seed)
        self._spin(0.0, 0.0)

    def _drive(self, steps: int) -> None:
        p, body, drive = self._p, self._body, self._drive_state
        # The client makes a new function object at every access, so each is looked up only once.
        pose_of, velocity_of, step = p.getBasePositionAndOrientation, p.getBaseVelocity, p.stepSimulation
        force_on, torque_on, world_frame = p.applyExternalForce, p.applyExternalTorque, p.WORLD_FRAME
        scalars, supports = self._mechanics.scalars, self._mechanics.supports
        noise = self._noise.standard_normal((steps, wheels.noises(supports)))
        friction = self.robot.base.wheel_friction * self.drawn.friction
        surface = self.drawn.slip, friction, self._ground(), self._lift
        (position, attitude), (velocity, rate) = pose_of(body), velocity_of(body)
        start_u = self.state.twist[0]
        contact, rolled, movers = False, 0.0, self._place_movers(steps, position)
        for k in range(steps):
            command, motion = self._target(self._steps * STEP), (*position, *attitude, *velocity[:2], rate[2])
            pulled = _pull(drive, command, self._table, scalars, supports, noise[k], surface, motion)
            force, torque, point, (left, right) = pulled
            if abs(left - self._rims[0]) + abs(right - self._rims[1]) > self._spin_step:
                self._spin(left, right)
            rolled += 0.5 * (left + right)
            force_on(body, -1, (*force, 0.0), (*point, 0.0), world_frame)
            torque_on(body, -1, (0.0, 0.0, torque), world_frame)
            self._steps += 1
            for cylinder, mover in movers:
                scene.put_mover(p, cylinder, *mover.position(self._steps * STEP))
            step()
            (position, attitude), (velocity, rate) = pose_of(body), velocity_of(body)
            contact = contact or self._touching(position, movers)
        x, y, yaw, u, upright = _planar(scalars, (*position, *attitude, *velocity[:2], rate[2]))
        span = steps * STEP
        self._odometry.update(span, rolled / steps, yaw, rate[2], (u - start_u) / span)
        odometry = self._odometry
        seen, flipped = (odometry.pose, odometry.twist), upright < 0.5
        self.state = RobotState(self._steps * STEP, (x, y, yaw), (u, rate[2]), *seen, contact, flipped, odometry.imu)

    def _place_movers(self, steps: int, position: Sequence[float]) -> List[Tuple[int, Mover]]:
        """Move all moving obstacles to their positions after `steps`, and return (body, Mover) of those close by."""
        now, then = self.mover_circles(self._steps * STEP), self.mover_circles((self._steps + steps) * STEP)
        reach, near = self._span + _CLOSING_M_S * steps * STEP, []
        for body, mover, here, there in zip(self._movers, self.world.movers, now.tolist(), then.tolist()):
            scene.put_mover(self._p, body, *there[:2])
            if min(dist(place[:2], position[:2]) for place in (here, there)) < reach + mover.radius:
                near.append((body, mover))
        return near

    def _touching(self, position: Sequence[float], movers: List[Tuple[int, Mover]]) -> bool:
        """Return whether an obstacle presses on the robot. `movers` is the list of _place_movers()."""
        if _find_near(self._circles, position[0], position[1], self._span, self._near):  # Queries to Bullet are slow.
            for obstacle, near in zip(self._obstacles, self._near):
                if near and self._pressing(obstacle):
                    return True
        return any(self._pressing(body) for body, _ in movers)

    def _pressing(self, body: int) -> bool:
        points = self._p.getContactPoints(self._body, body)
        return any(point[9] > 0.0 for point in points)  # Item 9 is the normal force.

    def _spin(self, left: float, right: float) -> None:
        """Turn Bullet's wheels at these rim speeds [m/s], because a turning wheel rubs on an obstacle."""
        self._rims, base, p = (left, right), self.robot.base, self._p
        speeds = (left / base.wheel_radius, right / base.wheel_radius) * (base.wheels // 2)
        forces = (self.robot.simulation.motor_torque,) * base.wheels
        wheels_of = self._body, range(base.wheels), p.VELOCITY_CONTROL
        p.setJointMotorControlArray(*wheels_of, targetVelocities=speeds, forces=forces)


@kernel
def _find_near(circles: Array, x: float, y: float, span: float, near: NDArray[np.bool_]) -> bool:
    """Mark in `near` (bodies,) the bodies with a circle (n, 4) within span [m] of (x, y). Return whether one is."""
    near[:] = False
    any_near = False
    for k in range(circles.shape[0]):
        dx, dy, far = circles[k, 0] - x, circles[k, 1] - y, circles[k, 2] + span
        if dx * dx + dy * dy < far * far:
            near[int(circles[k, 3])] = True
            any_near = True
    return any_near


@kernel
def _axes(qx: float, qy: float, qz: float, qw: float) -> Tuple[float, float, float, float, float]:
    """Return cosine and sine of the heading, and the third row of the rotation matrix (the heights of the axes)."""
    ahead_x, ahead_y = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz)
    length = max(np.hypot(ahead_x, ahead_y), 1e-9)
    up = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
    return ahead_x / length, ahead_y / length, up[0], up[1], up[2]


@kernel
def _pull(
    drive: Array,
    command: Pair,
    table: Array,
    scalars: Array,
    supports: Array,
    noise: Array,
    surface: Surface,
    motion: Motion,
) -> Tuple[Pair, float, Pair, Pair]:
    """Simulate wheels and tyres for one step.

    Returns:
        Horizontal force [N] and torque [N m] on the body in the world frame, their point of application on the ground
        below the centre of mass [m], and the rim speeds of the left and right wheels [m/s].
    """
    (slip, friction, ground, lift), (px, py, pz, qx, qy, qz, qw, vx, vy, rate) = surface, motion
    c, s, up_x, up_y, up_z = _axes(qx, qy, qz, qw)
    for i in range(supports.shape[0]):
        x, y = supports[i, m.BASE_X], supports[i, m.BASE_Y]
        height = pz + up_x * x + up_y * y + up_z * scalars[m.AXLE_Z] - scalars[m.WHEEL_RADIUS]
        lift[i] = min(max(1.0 - height / scalars[m.FULL_LIFT], 0.0), 1.0) if up_z > 0.5 else 0.0
    wheels.turn_wheels(drive, command[0], command[1], table, scalars, noise, slip, ground)
    # vector from the centre of mass of the body to that of the robot
    dx, dy = scalars[m.COM_X] - scalars[m.OFF_X], scalars[m.COM_Y] - scalars[m.OFF_Y]
    ahead, aside = c * vx + s * vy - rate * dy, c * vy - s * vx + rate * dx
    du, ds, dw = wheels.tyres(drive, (ahead, aside, rate), scalars, supports, friction, lift, ground)
    fx, fy, torque = scalars[m.MASS] / STEP * du, scalars[m.MASS] / STEP * ds, scalars[m.YAW_INERTIA] / STEP * dw
    point = px + c * dx - s * dy, py + s * dx + c * dy
    return (c * fx - s * fy, s * fx + c * fy), torque, point, (drive[wheels.LEFT], drive[wheels.RIGHT])


@kernel
def _planar(scalars: Array, motion: Motion) -> Tuple[float, float, float, float, float]:
    """Return x, y, yaw and forward speed of base_link, and the vertical component of its z axis (1: level)."""
    px, py, _, qx, qy, qz, qw, vx, vy, rate = motion
    c, s, _, _, up_z = _axes(qx, qy, qz, qw)
    off_x, off_y = scalars[m.OFF_X], scalars[m.OFF_Y]
    x, y = px - c * off_x + s * off_y, py - s * off_x - c * off_y
    return x, y, atan2(s, c), c * vx + s * vy + rate * off_y, up_z
