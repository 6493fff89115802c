"""Simulator with Bullet's physics at 240 Hz, PybulletSimulator, a replacement for Gazebo.

Bullet computes the support of the wheels and the contacts with obstacles, and wheels.py the
friction of the tyres on the ground. Any number of simulators may run in one process, without a
window. Results are reproducible for a seed.
"""

from __future__ import annotations

from math import atan2, dist
from typing import Any, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Quaternion, Twist
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.robots import Robot

from . import bullet_scene as scene
from . import wheels
from .mechanics import STEP
from .records import Records
from .simulator import Simulator
from .wheels import Vector, Vehicle

BodyPlacement = Tuple[Vector, Quaternion]  # position [m] and attitude of the body's centre of mass
BodyMotion = Tuple[Vector, Vector]  # velocity [m/s] and angular velocity [rad/s] in the world frame
_CLOSING_M_S = 20.0  # largest closing speed of a moving obstacle and the robot [m/s]
# Multiple of its largest speed that no base reaches unless something pushes it, which is near then
_OVERSPEED = 1.5
# Distance above which two bodies have no contact, Bullet's margin and penetration included [m]
_MARGIN_M = 0.1
# Indices of the other body and of the normal force in a contact point of Bullet
_OTHER_BODY = 2
_NORMAL_FORCE = 9


class PybulletSimulator(Simulator):
    """Simulated robot in Bullet; see Simulator."""

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any) -> None:
        super().__init__(robot, **randomisation)
        self._client = scene.connect()
        self._reach = self._mechanics.constants.reach + _MARGIN_M
        # Smallest change of the rim speeds that is passed to Bullet [m/s]: the call is slow.
        self._spin_step = 0.01 * self.robot.base.max_speed

    def close(self) -> None:
        """Disconnect from Bullet, as garbage collection would. Further calls have no effect."""
        self._client = None

    def _place(self, pose: Pose, new_world: bool) -> None:
        # The scene is rebuilt every time, because Bullet keeps contacts and solver state over a
        # change of position.
        scene.empty(self._client, STEP)
        self._circles = scene.build_obstacles(self._client, self.world)
        self._movers = scene.build_movers(self._client, self.passers_by.circles(0.0))
        self._body = scene.build_robot(self._client, self.robot, pose)
        self._stop_wheels()

    def _move_to(self, pose: Pose) -> None:
        scene.put_robot(self._client, self._body, self.robot, pose)
        self._stop_wheels()

    def _stop_wheels(self) -> None:
        self._reset_wheels()
        self._spin((0.0, 0.0))

    def _drive(self, steps: int) -> None:
        """Simulate some steps of STEP, and store the state after them."""
        client = self._client
        body = self._body
        placement_of = client.getBasePositionAndOrientation
        motion_of = client.getBaseVelocity
        world_frame = client.WORLD_FRAME
        noise = self._noise.standard_normal((steps, wheels.noises(self._supports)))

        placement = placement_of(body)
        motion = motion_of(body)
        near_movers = self._place_movers(steps, placement[0])
        x, y, _ = placement[0]
        reach = self._reach + _OVERSPEED * self.robot.base.max_speed * steps * STEP
        may_touch = bool(near_movers) or _is_near(self._circles, x, y, reach)
        has_touched = False
        rolled = 0.0
        for step_noise in noise:
            force, torque, point, rims = _pull(
                self.vehicle,
                self._supports,
                self._target(self._steps * STEP),
                self._table,
                step_noise,
                placement,
                motion,
            )
            left, right = rims
            shown_left, shown_right = self._rims
            # Bullet's wheels only rub on obstacles: they need not follow every small change.
            if abs(left - shown_left) + abs(right - shown_right) > self._spin_step:
                self._spin(rims)
            rolled += 0.5 * (left + right)
            client.applyExternalForce(body, -1, force, point, world_frame)
            client.applyExternalTorque(body, -1, torque, world_frame)
            self._steps += 1
            if near_movers:
                circles = self.passers_by.circles(self._steps * STEP).tolist()
                for number in near_movers:
                    x, y, _ = circles[number]
                    scene.put_mover(client, self._movers[number], x, y)
            client.stepSimulation()
            placement = placement_of(body)
            motion = motion_of(body)
            if may_touch and not has_touched:
                has_touched = self._touching(placement[0], bool(near_movers))

        # State of base_link at the end of the last step
        pose, speed, upright = _planar(self.vehicle, placement, motion)
        self._update(
            pose, (speed, motion[1][2]), rolled / steps, steps * STEP, has_touched, upright < 0.5
        )

    def _place_movers(self, steps: int, position: Sequence[float]) -> List[int]:
        """Move the moving obstacles to their places after `steps`.

        Returns:
            The numbers of those near `position`, which may touch the robot before.
        """
        starts = self.passers_by.circles(self._steps * STEP).tolist()
        ends = self.passers_by.circles((self._steps + steps) * STEP).tolist()
        reach = self._reach + _CLOSING_M_S * steps * STEP
        near = []
        for number, (start, end) in enumerate(zip(starts, ends)):
            x, y, radius = end
            if start != end:
                scene.put_mover(self._client, self._movers[number], x, y)
            # An obstacle passes on a path of unknown form between both positions.
            from_start = dist(start[:2], position[:2])
            from_end = dist(end[:2], position[:2])
            if min(from_start, from_end) < reach + radius:
                near.append(number)
        return near

    def _touching(self, position: Sequence[float], near: bool) -> bool:
        """Return whether an obstacle presses on the robot.

        Args:
            position: Position of the body in the world frame [m].
            near: Whether a moving obstacle is near.
        """
        # Queries to Bullet are slow, so a kernel looks first whether anything is near.
        if not near and not _is_near(self._circles, position[0], position[1], self._reach):
            return False
        for point in self._client.getContactPoints(self._body):
            if point[_OTHER_BODY] != scene.GROUND and point[_NORMAL_FORCE] > 0.0:
                return True
        return False

    def _spin(self, rims: Tuple[float, float]) -> None:
        """Turn Bullet's wheels at the rim speeds (left, right) [m/s]: they rub on obstacles."""
        self._rims = rims
        base = self.robot.base
        left, right = rims
        # Left and right alternate in geometry.wheel_places, once for each axle.
        speeds = (left / base.wheel_radius, right / base.wheel_radius) * (base.wheels // 2)
        forces = (self.robot.simulation.motor_torque,) * base.wheels
        self._client.setJointMotorControlArray(
            self._body,
            range(base.wheels),
            self._client.VELOCITY_CONTROL,
            targetVelocities=speeds,
            forces=forces,
        )


@kernel
def _is_near(circles: Array, x: float, y: float, distance: float) -> bool:
    """Return whether one of `circles` (n, 3) x, y, radius [m] is within `distance` of (x, y)."""
    for index in range(circles.shape[0]):
        offset_x = circles[index, 0] - x
        offset_y = circles[index, 1] - y
        limit = circles[index, 2] + distance
        if offset_x * offset_x + offset_y * offset_y < limit * limit:
            return True
    return False


class Axes(NamedTuple):
    """Attitude of the body."""

    cos_yaw: float
    sin_yaw: float
    up_x: float  # height of the forward, leftward and upward unit vectors of the body
    up_y: float
    up_z: float


@kernel
def _axes(attitude: Quaternion) -> Axes:
    """Return heading and tilt of a unit quaternion: first column and third row of its matrix."""
    qx, qy, qz, qw = attitude
    ahead_x = 1.0 - 2.0 * (qy * qy + qz * qz)
    ahead_y = 2.0 * (qx * qy + qw * qz)
    length = max(np.hypot(ahead_x, ahead_y), 1e-9)  # 0 if the robot stands on end
    up_x = 2.0 * (qx * qz - qw * qy)
    up_y = 2.0 * (qy * qz + qw * qx)
    up_z = 1.0 - 2.0 * (qx * qx + qy * qy)
    return Axes(ahead_x / length, ahead_y / length, up_x, up_y, up_z)


@kernel
def _pull(
    vehicles: Records,
    supports: Records,
    command: Twist,
    table: Array,
    noise: Array,
    placement: BodyPlacement,
    motion: BodyMotion,
) -> Tuple[Vector, Vector, Vector, Tuple[float, float]]:
    """Simulate wheels and tyres for one step.

    Args:
        vehicles: Record (1,) of Vehicle, which is updated.
        supports: Records (n,) of Support, which are updated.
        command: Velocity command (v, w) [m/s, rad/s].
        table: wheels.rim_table().
        noise: Standard normal random numbers (wheels.noises(),).
        placement: Position and attitude of the body's centre of mass.
        motion: Velocity and angular velocity of the body's centre of mass.

    Returns:
        Force [N] and torque [N m] on the body in the world frame, the force's point of application
        on the ground below the centre of mass [m], and the rim speeds of the left and right wheels
        [m/s].
    """
    vehicle: Vehicle = vehicles[0]
    constants = vehicle.constants
    drivetrain = vehicle.drivetrain
    position, attitude = placement
    velocity, turning = motion
    yaw_rate = turning[2]
    axes = _axes(attitude)
    cos_yaw = axes.cos_yaw
    sin_yaw = axes.sin_yaw
    for row in range(supports.shape[0]):
        # A wheel off the ground transmits no force, nor does any wheel of a robot on its side.
        support = supports[row]
        axle = position[2] + axes.up_x * support.body_x + axes.up_y * support.body_y
        height = axle + axes.up_z * constants.axle_z - constants.wheel_radius
        if axes.up_z > 0.5:
            support.lift = min(max(1.0 - height / constants.full_lift, 0.0), 1.0)
        else:
            support.lift = 0.0
    wheels.turn_wheels(vehicle, supports, command, table, noise)

    # Velocity and force are those of the robot's centre of mass, Bullet's those of the body's.
    offset_x = constants.com_x - constants.body_x
    offset_y = constants.com_y - constants.body_y
    forward = cos_yaw * velocity[0] + sin_yaw * velocity[1] - yaw_rate * offset_y
    leftward = cos_yaw * velocity[1] - sin_yaw * velocity[0] + yaw_rate * offset_x
    change = wheels.tyres(vehicle, supports, (forward, leftward, yaw_rate))
    force_forward = constants.mass / STEP * change[0]
    force_leftward = constants.mass / STEP * change[1]
    torque = constants.yaw_inertia / STEP * change[2]
    force = (
        cos_yaw * force_forward - sin_yaw * force_leftward,
        sin_yaw * force_forward + cos_yaw * force_leftward,
        0.0,
    )
    point = (
        position[0] + cos_yaw * offset_x - sin_yaw * offset_y,
        position[1] + sin_yaw * offset_x + cos_yaw * offset_y,
        0.0,
    )
    return force, (0.0, 0.0, torque), point, (drivetrain.left_rim, drivetrain.right_rim)


@kernel
def _planar(
    vehicles: Records, placement: BodyPlacement, motion: BodyMotion
) -> Tuple[Pose, float, float]:
    """Return pose and forward speed [m/s] of base_link, and the height of its z axis (1: level).

    `vehicles` is the record (1,) of a Vehicle, `placement` and `motion` are those of the body's
    centre of mass.
    """
    vehicle: Vehicle = vehicles[0]
    constants = vehicle.constants
    position, attitude = placement
    velocity, turning = motion
    axes = _axes(attitude)
    cos_yaw = axes.cos_yaw
    sin_yaw = axes.sin_yaw
    body_x = constants.body_x
    body_y = constants.body_y
    x = position[0] - cos_yaw * body_x + sin_yaw * body_y
    y = position[1] - sin_yaw * body_x - cos_yaw * body_y
    speed = cos_yaw * velocity[0] + sin_yaw * velocity[1] + turning[2] * body_y
    return (x, y, atan2(sin_yaw, cos_yaw)), speed, axes.up_z
