"""Planar simulator without a physics engine, KinematicSimulator, for training at high throughput.

Interface, laser, odometry, wheels and tyres are the same as in PybulletSimulator. Contacts are solved in the plane.
Three numbers of the robot's description (wheel_rub, body_rub, undo) are fitted to PybulletSimulator. They account for
three-dimensional effects, such as a wheel that climbs an obstacle.
"""

from __future__ import annotations

from math import atan2, ceil, cos, hypot, inf, sin
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.robots import Robot

from . import mechanics as m
from . import wheels
from .mechanics import STEP
from .simulator import RobotState, Simulator

Contact = Tuple[float, float, float, float, float]  # depth [m], point (2) [m], direction (2)
Constants = Tuple[Array, Array, Array, Array]  # scalars, supports and parts of Mechanics, and wheels.rim_table()
Obstacles = Tuple[Array, Array]  # circles (n, 5) x, y, radius [m], velocity [m/s], and boxes (m, 5) as in World
# Indices of the state: pose of the centre of mass, velocity ahead and to the left, yaw rate; outputs of drive(): mean
# speed of the rims [m/s], and 1 if there was a contact
X, Y, YAW, U, S, W, ROLLED, CONTACT, SIZE = range(9)
_MARGIN_M = 0.02  # distance below which contacts are tracked [m]
_UNDONE_M_S = 1.0  # largest speed at which an overlap is resolved [m/s]
_SWEEPS = 8  # number of solver iterations over all contacts
_MOST_CONTACTS = 24  # largest number of simultaneous contacts
JUMP_M_S = 10.0  # apparent speed above which a moving obstacle has jumped back to the start of its animation [m/s]


class KinematicSimulator(Simulator):
    """Planar simulated robot; see Simulator."""

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any) -> None:
        super().__init__(robot, **randomisation)
        mechanics = self._mechanics = m.mechanics(self.robot)
        self._constants = mechanics.scalars, mechanics.supports, mechanics.parts, wheels.rim_table(self.robot)
        self._noises = wheels.noises(mechanics.supports)

    def _place(self, pose: Pose, new_world: bool) -> None:
        if new_world:
            self._circles = np.zeros((len(self.world.cylinders), 5))  # x, y, radius, velocity
            self._circles[:, :3] = self.world.cylinders
            self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)
        self._move_to(pose)

    def _move_to(self, pose: Pose) -> None:
        self._rolling = wheels.new_drive(self._mechanics.supports, self._angle_seed)
        self._body = np.zeros(SIZE)
        self._body[:3] = *transform_point(pose, *self._mechanics.com), pose[2]

    def _drive(self, steps: int) -> None:
        circles = self._circles
        if self.world.movers:
            now, then = self.mover_circles(), self.mover_circles(self._steps * STEP + steps * STEP)
            velocity = (then - now)[:, :2] / (steps * STEP)
            velocity[np.hypot(*velocity.T) > JUMP_M_S] = 0.0
            circles = np.concatenate([circles, np.hstack([now, velocity])])
        ground, shape = self._ground(), (steps, self._noises)
        # Gazebo's wheels have no noise.
        noise = self._noise.standard_normal(shape) if ground < 1.0 else np.zeros(shape)
        surface = self.drawn.slip, self.robot.base.wheel_friction * self.drawn.friction, ground
        drive(self._body, self._rolling, self._schedule(steps), (circles, self._boxes), self._constants, noise, surface)
        self._steps += steps
        x, y, yaw, u, s, w, rolled, contact = self._body.tolist()
        com_x, com_y = self._mechanics.com
        u += w * com_y  # from the centre of mass to base_link
        odometry, span = self._odometry, steps * STEP
        odometry.update(span, rolled, yaw, w, (u - self.state.twist[0]) / span)
        pose = (*transform_point((x, y, yaw), -com_x, -com_y), yaw)
        self.state = RobotState(
            self._steps * STEP, pose, (u, w), odometry.pose, odometry.twist, contact > 0.0, False, odometry.imu
        )

    def _schedule(self, steps: int) -> Array:
        """Return the velocity targets (k, 3): first step, v [m/s] and w [rad/s] of each."""
        start, command = self._steps, self._command
        rows = [(0, *self._target(start * STEP))]
        step, last = 0, (start + steps - 1) * STEP
        while True:  # There is one iteration per command or time-out.
            change = command.pending[0][0] if command.pending else inf
            if (start + step) * STEP < command.until - 1e-9:
                change = min(change, command.until)
            if change - 1e-9 > last:
                return np.array(rows)
            step = max(step + 1, ceil((change - 1e-9) / STEP) - start)
            rows.append((step, *self._target((start + step) * STEP)))


@kernel
def _circle_contact(px: float, py: float, r: float, part: Array) -> Contact:
    """Return the contact of a circle at (px, py) in the body frame with one part of the outline.

    Returns:
        Depth [m] (negative for a gap), contact point [m], and direction in which the contact pushes the robot.
    """
    x, y, a, b = part[0], part[1], part[2], part[3]
    px, py = px - x, py - y
    qx, qy = min(max(px, -a), a), min(max(py, -b), b)
    gap = hypot(px - qx, py - qy)
    if gap > 0.0:
        return r - gap, x + qx, y + qy, (qx - px) / gap, (qy - py) / gap
    if a - abs(px) < b - abs(py):  # The centre is under the robot, so the nearest side pushes.
        sign = 1.0 if px > 0.0 else -1.0
        return r + a - abs(px), x + sign * a, y + py, -sign, 0.0
    sign = 1.0 if py > 0.0 else -1.0
    return r + b - abs(py), x + px, y + sign * b, 0.0, -sign


@kernel
def _box_contact(px: float, py: float, ax: float, ay: float, hx: float, hy: float, part: Array) -> Contact:
    """Return the contact of a box at (px, py) with axis (ax, ay) and half sizes hx, hy with one part of the outline.

    Returns the same values as _circle_contact, from the smallest overlap along four axes.
    """
    x, y, a, b = part[0], part[1], part[2], part[3]
    px, py = px - x, py - y
    depth, nx, ny, own = np.inf, 0.0, 0.0, True
    for k, (ex, ey) in enumerate(((1.0, 0.0), (0.0, 1.0), (ax, ay), (-ay, ax))):
        apart = px * ex + py * ey
        if apart < 0.0:
            ex, ey, apart = -ex, -ey, -apart
        reach = a * abs(ex) + b * abs(ey) + hx * abs(ax * ex + ay * ey) + hy * abs(ax * ey - ay * ex)
        if reach - apart < depth - 1e-9:
            depth, nx, ny, own = reach - apart, -ex, -ey, k < 2
    if own:  # A corner of the box touches a side of the part.
        i = 1.0 if nx * ax + ny * ay > 0.0 else -1.0
        j = 1.0 if ny * ax - nx * ay > 0.0 else -1.0
        qx, qy = px + i * hx * ax - j * hy * ay, py + i * hx * ay + j * hy * ax
        return depth, x + min(max(qx, -a), a), y + min(max(qy, -b), b), nx, ny
    return depth, x + (-a if nx > 0.0 else a), y + (-b if ny > 0.0 else b), nx, ny


@kernel
def _contacts(
    x: float, y: float, c: float, s: float, parts: Array, reach: float, circles: Array, boxes: Array, contacts: Array
) -> int:
    """Write the contacts of the outline at (x, y) with heading (c, s) into `contacts`, and return their number.

    `reach` [m] is the radius of a circle around all `parts` (k, 4) of Mechanics. The columns of `contacts` (n, 8) are
    depth, point, direction, part (0: body, from 1: wheels) and velocity of the obstacle, all in the body frame.
    """
    n = 0
    reach = reach + _MARGIN_M
    for i in range(circles.shape[0]):
        dx, dy = circles[i, 0] - x, circles[i, 1] - y
        far = circles[i, 2] + reach
        if dx * dx + dy * dy >= far * far:
            continue
        px, py = c * dx + s * dy, c * dy - s * dx
        for k in range(parts.shape[0]):
            depth, qx, qy, nx, ny = _circle_contact(px, py, circles[i, 2], parts[k])
            if depth > -_MARGIN_M and n < _MOST_CONTACTS:
                its_u, its_s = c * circles[i, 3] + s * circles[i, 4], c * circles[i, 4] - s * circles[i, 3]
                contacts[n] = depth, qx, qy, nx, ny, float(k), its_u, its_s
                n += 1
    for i in range(boxes.shape[0]):
        dx, dy = boxes[i, 0] - x, boxes[i, 1] - y
        hx, hy = 0.5 * boxes[i, 3], 0.5 * boxes[i, 4]
        px, py = c * dx + s * dy, c * dy - s * dx
        cb, sb = cos(boxes[i, 2]), sin(boxes[i, 2])
        along = abs(cb * dx + sb * dy) - hx
        aside = abs(cb * dy - sb * dx) - hy
        if along > reach or aside > reach:
            continue
        for k in range(parts.shape[0]):
            depth, qx, qy, nx, ny = _box_contact(px, py, c * cb + s * sb, c * sb - s * cb, hx, hy, parts[k])
            if depth > -_MARGIN_M and n < _MOST_CONTACTS:
                contacts[n] = depth, qx, qy, nx, ny, float(k), 0.0, 0.0
                n += 1
    return n


@kernel
def _press(
    u: float, s: float, w: float, contacts: Array, n: int, rims: Array, scalars: Array
) -> Tuple[float, float, float, bool]:
    """Return the velocity (u, s, w) after the impulses of n contacts, and whether any contact pressed.

    Normal impulses limit the approach to the gap and resolve a share UNDO of an overlap. Coulomb friction acts with
    coefficient WHEEL_RUB at wheels and BODY_RUB at the body. The front or back of a wheel also rubs up or down the
    obstacle, which leaves less friction against lateral motion.
    """
    mass, inertia = scalars[m.MASS], scalars[m.YAW_INERTIA]
    push, hold = np.zeros(n), np.zeros(n)
    for _ in range(_SWEEPS):
        for i in range(n):
            depth, x, y, nx, ny, part, its_u, its_s = contacts[i]
            arm = x * ny - y * nx
            soft = 1.0 / mass + arm * arm / inertia
            speed = (u - w * y - its_u) * nx + (s + w * x - its_s) * ny
            want = depth / STEP if depth < 0.0 else min(scalars[m.UNDO] * depth / STEP, _UNDONE_M_S)
            total = max(0.0, push[i] + (want - speed) / soft)
            d, push[i] = total - push[i], total
            u += d * nx / mass
            s += d * ny / mass
            w += d * arm / inertia
            if total > 0.0:
                tx, ty = -ny, nx
                arm = x * ty - y * tx
                soft = 1.0 / mass + arm * arm / inertia
                speed = (u - w * y - its_u) * tx + (s + w * x - its_s) * ty
                limit = scalars[m.BODY_RUB] * total
                if part > 0.0:
                    up = rims[int(part - 1) % 2] * abs(nx)
                    limit = scalars[m.WHEEL_RUB] * total * abs(speed) / (hypot(speed, up) + 1e-6)
                rub = min(max(hold[i] - speed / soft, -limit), limit)
                d, hold[i] = rub - hold[i], rub
                u += d * tx / mass
                s += d * ty / mass
                w += d * arm / inertia
    pressed = False
    for i in range(n):
        pressed |= push[i] > 0.0
    return u, s, w, pressed


@kernel
def _near(obstacles: Array, radii: Array, x: float, y: float, span: float) -> Array:
    """Return a copy of the obstacles (n, 5) whose circles of radii (n,) [m] reach within span [m] of (x, y)."""
    dx, dy, far = obstacles[:, 0] - x, obstacles[:, 1] - y, radii + span
    return obstacles[dx * dx + dy * dy < far * far]


@kernel
def drive(
    state: Array, rolling: Array, targets: Array, obstacles: Obstacles, robot: Constants, noise: Array, surface: Pose
) -> None:
    """Advance state (SIZE,) and rolling (wheels.new_drive()) by one step of STEP for each row of `noise`.

    `targets` (k, 3) are velocity targets: first step, v [m/s] and w [rad/s] of each. The random numbers `noise` (steps,
    wheels.noises()) are standard normal. `surface` is slip, friction and ground, which wheels.py explains.
    """
    (scalars, supports, parts, table), (circles, boxes), (slip, friction, ground), steps = (
        robot,
        obstacles,
        surface,
        len(noise),
    )
    reach = scalars[m.REACH]
    span = reach + _MARGIN_M + steps * STEP * (scalars[m.MAX_SPEED] + 0.5)
    circles = _near(circles, circles[:, 2], state[X], state[Y], span)
    boxes = _near(boxes, 0.5 * np.hypot(boxes[:, 3], boxes[:, 4]), state[X], state[Y], span)
    contacts, lift, rims = np.empty((_MOST_CONTACTS, 8)), np.ones(supports.shape[0]), np.empty(2)
    x, y, yaw, u, s, w = state[X], state[Y], state[YAW], state[U], state[S], state[W]
    contact, rolled, k_target = False, 0.0, 0
    for step in range(steps):
        while k_target + 1 < targets.shape[0] and targets[k_target + 1, 0] <= step:
            k_target += 1
        _, v, yaw_rate = targets[k_target]
        wheels.turn_wheels(rolling, v, yaw_rate, table, scalars, noise[step], slip, ground)
        rims[0], rims[1] = rolling[wheels.LEFT], rolling[wheels.RIGHT]
        rolled += 0.5 * (rims[0] + rims[1])
        du, ds, dw = wheels.tyres(rolling, (u, s, w), scalars, supports, friction, lift, ground)
        u, s, w = u + du, s + ds, w + dw
        c, sn = cos(yaw), sin(yaw)
        n = _contacts(x, y, c, sn, parts, reach, circles, boxes, contacts)
        if n > 0:
            u, s, w, pressed = _press(u, s, w, contacts, n, rims, scalars)
            contact |= pressed
        for i in range(circles.shape[0]):
            circles[i, 0] += STEP * circles[i, 3]
            circles[i, 1] += STEP * circles[i, 4]
        x += STEP * (c * u - sn * s)
        y += STEP * (sn * u + c * s)
        yaw += STEP * w
        c, sn = cos(STEP * w), sin(STEP * w)
        u, s = c * u + sn * s, c * s - sn * u
    state[X], state[Y], state[YAW], state[U], state[S], state[W] = x, y, atan2(sin(yaw), cos(yaw)), u, s, w
    state[ROLLED], state[CONTACT] = rolled / steps, 1.0 if contact else 0.0
