"""PybulletSimulator: the four-wheel Jackal in Bullet's physics at 240 Hz, standing in for Gazebo.

Bullet carries the robot on its wheels, and stops, turns, tilts and pushes it at obstacles; the tyres' pull on
the ground is skid_steer.py's. In-process and without a window; any number may live in one process. Repeats
exactly under a seed.
"""

from __future__ import annotations

import os
from math import atan2
from typing import Any

import numpy as np

from applr_ros1.common.kernels import kernel

from . import bullet_scene as scene
from . import jackal, skid_steer
from .odometry import Odometry
from .simulator import RobotState, Simulator, SimulatorError

STEP = skid_steer.STEP
_MOTOR_TORQUE = 10.0  # [N m] a wheel, against obstacles
_FULL_LIFT = 0.005  # a wheel this high above the ground pulls no more [m]
_OFF_X, _OFF_Y, _OFF_Z = jackal.CHASSIS_COM


class PybulletSimulator(Simulator):
    """See Simulator. gui=True opens pybullet's window."""

    def __init__(self, gui: bool = False, **randomisation: Any):
        self._client: Any = None
        super().__init__(**randomisation)
        self._p = scene.load_pybullet()
        if gui and not os.environ.get("DISPLAY"):
            raise SimulatorError("gui is true but there is no display (DISPLAY is not set): leave gui away")
        self._client = self._p.connect(self._p.GUI if gui else self._p.DIRECT)
        self._table = skid_steer.rim_table()
        self._lift = np.ones(4)

    def close(self) -> None:
        """Disconnect from Bullet; can be called again."""
        if self._client is not None:
            self._p.disconnect(self._client)
            self._client = None

    def __del__(self):
        self.close()

    def _place(self, pose, new_world, seed):
        # Built anew every time: Bullet keeps contacts and solver state over a mere change of position.
        self._obstacles = scene.build_world(self._p, self._client, self.world, STEP)
        self._movers = [scene.add_mover(self._p, self._client, mover) for mover in self.world.movers]
        self._robot = scene.build_robot(self._p, self._client, pose)
        rng = np.random.default_rng(seed)
        self._odometry = Odometry(pose[2], rng)
        self._noise = np.random.default_rng([seed, 1])
        self._drive_state = np.zeros(skid_steer.SIZE)
        self._wheels = (0.0, 0.0)
        self._spin(0.0, 0.0)
        self._steps, self._elapsed = 0, 0.0
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)

    def _move_to(self, pose):
        scene.put_robot(self._p, self._client, self._robot, pose)
        self._drive_state = np.zeros(skid_steer.SIZE)
        self._spin(0.0, 0.0)

    def _drive(self, duration):
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps <= 0:
            return
        p, client, robot, drive = self._p, self._client, self._robot, self._drive_state
        noise = self._noise.standard_normal((steps, skid_steer.NOISES))
        friction, slip = jackal.WHEEL_FRICTION * self.drawn.friction, self.drawn.slip
        position, attitude = p.getBasePositionAndOrientation(robot, physicsClientId=client)
        velocity, rate = p.getBaseVelocity(robot, physicsClientId=client)
        start_u = self.state.twist[0]
        contact, rolled = False, 0.0
        for k in range(steps):
            v, w = self._target(self._steps * STEP)
            fx, fy, torque, px, py, left, right = _pull(
                drive,
                v,
                w,
                self._table,
                noise[k],
                slip,
                friction,
                self._lift,
                *position,
                *attitude,
                velocity[0],
                velocity[1],
                rate[2],
            )
            if abs(left - self._wheels[0]) + abs(right - self._wheels[1]) > 0.02:
                self._spin(left, right)
            rolled += 0.5 * (left + right)
            p.applyExternalForce(robot, -1, (fx, fy, 0.0), (px, py, 0.0), p.WORLD_FRAME, physicsClientId=client)
            p.applyExternalTorque(robot, -1, (0.0, 0.0, torque), p.WORLD_FRAME, physicsClientId=client)
            self._steps += 1
            for body, mover in zip(self._movers, self.world.movers):
                scene.put_mover(p, client, body, *mover.position(self._steps * STEP))
            p.stepSimulation(physicsClientId=client)
            position, attitude = p.getBasePositionAndOrientation(robot, physicsClientId=client)
            velocity, rate = p.getBaseVelocity(robot, physicsClientId=client)
            contact = contact or self._touching(position)
        x, y, yaw, u, upright = _planar(*position, *attitude, velocity[0], velocity[1], rate[2])
        span = steps * STEP
        self._odometry.update(span, rolled / steps, yaw, rate[2], (u - start_u) / span)
        odometry = self._odometry
        self.state = RobotState(
            self._steps * STEP,
            (x, y, yaw),
            (u, rate[2]),
            odometry.pose,
            odometry.twist,
            contact,
            upright < 0.5,
            odometry.imu,
        )

    def _touching(self, position):
        """Whether anything but the ground presses on the robot now."""
        for body in self._obstacles:
            if self._pressing(body):
                return True
        for body, mover in zip(self._movers, self.world.movers):
            x, y = mover.position(self._steps * STEP)
            near = abs(x - position[0]) + abs(y - position[1]) < 1.5 * mover.radius + 1.0
            if near and self._pressing(body):
                return True
        return False

    def _pressing(self, body):
        points = self._p.getContactPoints(self._robot, body, physicsClientId=self._client)
        return any(point[9] > 0.0 for point in points)  # [9]: normal force

    def _spin(self, left, right):
        """Turn the wheels with these rim speeds [m/s]: what an obstacle that touches one feels."""
        p = self._p
        self._wheels = (left, right)
        left, right = left / jackal.WHEEL_RADIUS, right / jackal.WHEEL_RADIUS
        p.setJointMotorControlArray(
            self._robot,
            (0, 1, 2, 3),
            p.VELOCITY_CONTROL,
            targetVelocities=(left, right, left, right),
            forces=(_MOTOR_TORQUE,) * 4,
            physicsClientId=self._client,
        )


@kernel
def _axes(qx, qy, qz, qw):
    """Cosine and sine of the heading, and the heights of the body's three axes.

    The heights are the third row of the rotation matrix.
    """
    ahead_x, ahead_y = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz)
    length = max(np.hypot(ahead_x, ahead_y), 1e-9)
    return (
        ahead_x / length,
        ahead_y / length,
        2.0 * (qx * qz - qw * qy),
        2.0 * (qy * qz + qw * qx),
        1.0 - 2.0 * (qx * qx + qy * qy),
    )


@kernel
def _pull(drive, v, w, table, noise, slip, friction, lift, px, py, pz, qx, qy, qz, qw, vx, vy, rate):
    """One step of wheels and tyres.

    Returns world-frame force (fx, fy) and torque on the body, the point on the ground below the centre of mass where
    they act, and the rim speeds of the left and right wheels [m/s].
    """
    c, s, up_x, up_y, up_z = _axes(qx, qy, qz, qw)
    for i in range(4):
        x = (0.5 if i < 2 else -0.5) * jackal.WHEELBASE - _OFF_X
        y = (0.5 if i % 2 == 0 else -0.5) * jackal.TRACK - _OFF_Y
        height = pz + up_x * x + up_y * y + up_z * (jackal.AXLE_HEIGHT - _OFF_Z) - jackal.WHEEL_RADIUS
        lift[i] = min(max(1.0 - height / _FULL_LIFT, 0.0), 1.0) if up_z > 0.5 else 0.0
    skid_steer.turn_wheels(drive, v, w, table, noise, slip)
    dx, dy = jackal.COM[0] - _OFF_X, jackal.COM[1] - _OFF_Y  # from the chassis's to the whole centre of mass
    ahead, aside = c * vx + s * vy - rate * dy, c * vy - s * vx + rate * dx
    du, ds, dw = skid_steer.tyres(drive, ahead, aside, rate, friction, lift)
    fx, fy = jackal.MASS / STEP * du, jackal.MASS / STEP * ds
    return (
        c * fx - s * fy,
        s * fx + c * fy,
        jackal.YAW_INERTIA / STEP * dw,
        px + c * dx - s * dy,
        py + s * dx + c * dy,
        drive[skid_steer.LEFT],
        drive[skid_steer.RIGHT],
    )


@kernel
def _planar(px, py, pz, qx, qy, qz, qw, vx, vy, rate):
    """x, y, yaw of base_link, its speed ahead, and how upright it stands (1: level)."""
    c, s, _, _, up_z = _axes(qx, qy, qz, qw)
    return (
        px - c * _OFF_X + s * _OFF_Y,
        py - s * _OFF_X - c * _OFF_Y,
        atan2(s, c),
        c * vx + s * vy + rate * _OFF_Y,
        up_z,
    )
