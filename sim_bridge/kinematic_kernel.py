"""The planar robot in numba: the tyres of wheels.py, and contacts that push and slide by geometry.

KinematicSimulator calls `drive`. What Bullet does in space (lift of a wheel at an obstacle, its way of rubbing) is in
three fitted numbers.
"""

from math import atan2, cos, hypot, sin

import numpy as np

from applr_ros1.common.kernels import kernel

from . import mechanics as m
from . import wheels

STEP = m.STEP
# the state: pose of the centre of mass, its velocity ahead and to the left, yaw rate; what a drive reports
X, Y, YAW, U, S, W, ROLLED, CONTACT, SIZE = range(9)
_MARGIN = 0.02  # contacts are watched from this distance on [m]
_MOST_UNDONE = 1.0  # speed at which an overlap is undone, at most [m/s]
_SWEEPS = 8
_MOST = 24  # contacts at a time


@kernel
def _circle_contact(px, py, r, part):
    """Contact of a circle at (px, py) in the body's frame with one part of the outline.

    Returns the depth (negative: a gap) [m], the contact point and the direction in which it pushes the robot.
    """
    x, y, a, b = part[0], part[1], part[2], part[3]
    px, py = px - x, py - y
    qx, qy = min(max(px, -a), a), min(max(py, -b), b)
    gap = hypot(px - qx, py - qy)
    if gap > 0.0:
        return r - gap, x + qx, y + qy, (qx - px) / gap, (qy - py) / gap
    if a - abs(px) < b - abs(py):  # the centre is under the robot: out by the nearest side
        sign = 1.0 if px > 0.0 else -1.0
        return r + a - abs(px), x + sign * a, y + py, -sign, 0.0
    sign = 1.0 if py > 0.0 else -1.0
    return r + b - abs(py), x + px, y + sign * b, 0.0, -sign


@kernel
def _box_contact(px, py, ax, ay, hx, hy, part):
    """Contact of a box at (px, py) with axis (ax, ay) and half sizes hx, hy with one part of the outline.

    Returns the same as _circle_contact, from the least overlap over four axes.
    """
    x, y, a, b = part[0], part[1], part[2], part[3]
    px, py = px - x, py - y
    depth, nx, ny, own = np.inf, 0.0, 0.0, True
    for k in range(4):
        if k == 0:
            ex, ey = 1.0, 0.0
        elif k == 1:
            ex, ey = 0.0, 1.0
        elif k == 2:
            ex, ey = ax, ay
        else:
            ex, ey = -ay, ax
        apart = px * ex + py * ey
        if apart < 0.0:
            ex, ey, apart = -ex, -ey, -apart
        reach = a * abs(ex) + b * abs(ey) + hx * abs(ax * ex + ay * ey) + hy * abs(ax * ey - ay * ex)
        if reach - apart < depth - 1e-9:
            depth, nx, ny, own = reach - apart, -ex, -ey, k < 2
    if own:  # a corner of the box at one of the part's sides
        i = 1.0 if nx * ax + ny * ay > 0.0 else -1.0
        j = 1.0 if ny * ax - nx * ay > 0.0 else -1.0
        qx, qy = px + i * hx * ax - j * hy * ay, py + i * hx * ay + j * hy * ax
        return depth, x + min(max(qx, -a), a), y + min(max(qy, -b), b), nx, ny
    return depth, x + (-a if nx > 0.0 else a), y + (-b if ny > 0.0 else b), nx, ny


@kernel
def _note(row, depth, x, y, nx, ny, part):
    row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7] = depth, x, y, nx, ny, part, 0.0, 0.0


@kernel
def _contacts(x, y, c, s, parts, reach, circles, n_circles, boxes, n_boxes, found):
    """Fill found (_MOST, 8) with the contacts of the outline at (x, y), heading (c, s), and return how many there are.

    parts (k, 4): of Mechanics, none reaches farther than `reach`. Columns of found: depth, point, direction, part (0
    the body, 1 on the wheels), the obstacle's velocity, all in the body's frame.
    """
    n = 0
    reach = reach + _MARGIN
    for i in range(n_circles):
        dx, dy = circles[i, 0] - x, circles[i, 1] - y
        far = circles[i, 2] + reach
        if dx * dx + dy * dy >= far * far:
            continue
        px, py = c * dx + s * dy, c * dy - s * dx
        for k in range(parts.shape[0]):
            depth, qx, qy, nx, ny = _circle_contact(px, py, circles[i, 2], parts[k])
            if depth > -_MARGIN and n < _MOST:
                _note(found[n], depth, qx, qy, nx, ny, k)
                found[n, 6] = c * circles[i, 3] + s * circles[i, 4]
                found[n, 7] = c * circles[i, 4] - s * circles[i, 3]
                n += 1
    for i in range(n_boxes):
        dx, dy = boxes[i, 0] - x, boxes[i, 1] - y
        hx, hy = 0.5 * boxes[i, 3], 0.5 * boxes[i, 4]
        px, py = c * dx + s * dy, c * dy - s * dx
        cb, sb = cos(boxes[i, 2]), sin(boxes[i, 2])
        along = abs(cb * dx + sb * dy) - hx  # outside the box by more than the robot's reach?
        aside = abs(cb * dy - sb * dx) - hy
        if along > reach or aside > reach:
            continue
        for k in range(parts.shape[0]):
            depth, qx, qy, nx, ny = _box_contact(px, py, c * cb + s * sb, c * sb - s * cb, hx, hy, parts[k])
            if depth > -_MARGIN and n < _MOST:
                _note(found[n], depth, qx, qy, nx, ny, k)
                n += 1
    return n


@kernel
def _press(u, s, w, found, n, rims, scalars):
    """Impulses of n contacts on the moving body: the velocity (u, s, w) after them, and whether any pressed.

    Normal: no approach beyond the gap, a share UNDO of an overlap is undone. Friction: Coulomb's, WHEEL_RUB at
    wheels and BODY_RUB at the body; a wheel's front and back run up or down the obstacle, which leaves less
    friction for sliding across.
    """
    mass, inertia = scalars[m.MASS], scalars[m.YAW_INERTIA]
    push, hold = np.zeros(n), np.zeros(n)
    for _ in range(_SWEEPS):
        for i in range(n):
            depth, x, y, nx, ny, part, its_u, its_s = found[i]
            arm = x * ny - y * nx
            soft = 1.0 / mass + arm * arm / inertia
            speed = (u - w * y - its_u) * nx + (s + w * x - its_s) * ny
            want = depth / STEP if depth < 0.0 else min(scalars[m.UNDO] * depth / STEP, _MOST_UNDONE)
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
def drive(
    state,
    rolling,
    steps,
    targets,
    circles,
    boxes,
    scalars,
    supports,
    parts,
    table,
    noise,
    friction,
    slip,
    ground,
):
    """Advance state (SIZE,) and rolling (wheels.new_drive()) by `steps` steps of STEP.

    targets (k, 3): the steps from which velocity targets hold, and these. circles (n, 5) x, y,
    radius, velocity, boxes (m, 5): what may be hit. scalars, supports, parts: of Mechanics. table: wheels.rim_table().
    noise (steps, wheels.noises()) standard normal. friction, ground: as wheels.tyres() takes them.
    """
    reach = scalars[m.REACH]
    span = reach + _MARGIN + steps * STEP * (scalars[m.MAX_SPEED] + 0.5)
    close = np.empty((circles.shape[0], 5))
    n_close = 0
    for k in range(circles.shape[0]):
        dx, dy, far = circles[k, 0] - state[X], circles[k, 1] - state[Y], circles[k, 2] + span
        if dx * dx + dy * dy < far * far:
            close[n_close] = circles[k]
            n_close += 1
    near_boxes = np.empty((boxes.shape[0], 5))
    n_boxes = 0
    for k in range(boxes.shape[0]):
        dx, dy = boxes[k, 0] - state[X], boxes[k, 1] - state[Y]
        far = 0.5 * hypot(boxes[k, 3], boxes[k, 4]) + span
        if dx * dx + dy * dy < far * far:
            near_boxes[n_boxes] = boxes[k]
            n_boxes += 1
    found, lift, rims = np.empty((_MOST, 8)), np.ones(supports.shape[0]), np.empty(2)
    x, y, yaw, u, s, w = state[X], state[Y], state[YAW], state[U], state[S], state[W]
    contact, rolled, k_target = False, 0.0, 0
    for step in range(steps):
        while k_target + 1 < targets.shape[0] and targets[k_target + 1, 0] <= step:
            k_target += 1
        _, v, yaw_rate = targets[k_target]
        wheels.turn_wheels(rolling, v, yaw_rate, table, scalars, noise[step], slip, ground)
        rims[0], rims[1] = rolling[wheels.LEFT], rolling[wheels.RIGHT]
        rolled += 0.5 * (rims[0] + rims[1])
        du, ds, dw = wheels.tyres(rolling, u, s, w, scalars, supports, friction, lift, ground)
        u, s, w = u + du, s + ds, w + dw
        c, sn = cos(yaw), sin(yaw)
        if n_close > 0 or n_boxes > 0:
            n = _contacts(x, y, c, sn, parts, reach, close, n_close, near_boxes, n_boxes, found)
            if n > 0:
                u, s, w, pressed = _press(u, s, w, found, n, rims, scalars)
                contact |= pressed
        for i in range(n_close):
            close[i, 0] += STEP * close[i, 3]
            close[i, 1] += STEP * close[i, 4]
        x += STEP * (c * u - sn * s)
        y += STEP * (sn * u + c * s)
        yaw += STEP * w
        c, sn = cos(STEP * w), sin(STEP * w)
        u, s = c * u + sn * s, c * s - sn * u
    state[X], state[Y], state[YAW], state[U], state[S], state[W] = x, y, atan2(sin(yaw), cos(yaw)), u, s, w
    state[ROLLED], state[CONTACT] = rolled / steps, 1.0 if contact else 0.0
