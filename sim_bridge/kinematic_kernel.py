"""The kinematic Jackal's motion in numba: lag, slip, drift, and contacts that push and slide by geometry.

KinematicSimulator calls `drive`. Indices of the state vector stand below; the parameters are KinematicParameters' fields,
in order (kinematic_simulator.py), fitted to the pybullet Jackal by sim_bridge/fit.py.
"""
from math import atan2, cos, exp, hypot, sin, sqrt

import numpy as np
from numba import njit

from . import jackal

STEP = 0.01                                        # [s]
X, Y, YAW, U, S, W, RAMP_V, RAMP_W, SLIP_U, SLIP_S, SLIP_W, WHEEL_V, CONTACT, ACCEL, SIZE = range(15)
# u, s: body velocity ahead and to the left; ramp: the velocity controller's output; wheel_v: what the wheels turn at


@njit(cache=True)
def _ramp(now, goal, rate):
    return min(max(goal, now - rate), now + rate)


@njit(cache=True)
def _circle_contact(x, y, c, s, cx, cy, r):
    """Depth [m] (<= 0: none), contact point and push direction, in the body's frame, robot outline against a circle."""
    dx, dy = cx - x, cy - y
    px, py = c * dx + s * dy, c * dy - s * dx
    a, b = jackal.BODY_HALF_LENGTH, jackal.BODY_HALF_WIDTH
    qx, qy = min(max(px, -a), a), min(max(py, -b), b)
    gap = hypot(px - qx, py - qy)
    if gap > 0.0:
        return r - gap, qx, qy, (qx - px) / gap, (qy - py) / gap
    if a - abs(px) < b - abs(py):                   # the centre is under the robot: out by the nearest side
        sign = 1.0 if px > 0.0 else -1.0
        return r + a - abs(px), sign * a, py, -sign, 0.0
    sign = 1.0 if py > 0.0 else -1.0
    return r + b - abs(py), px, sign * b, 0.0, -sign


@njit(cache=True)
def _box_contact(x, y, c, s, box):
    """As _circle_contact, against a box (x, y, yaw, size_x, size_y): least overlap over the four axes of both."""
    dx, dy = box[0] - x, box[1] - y
    px, py = c * dx + s * dy, c * dy - s * dx        # the box's centre and axes in the body's frame
    cb, sb = cos(box[2]), sin(box[2])
    ax, ay = c * cb + s * sb, c * sb - s * cb
    hx, hy = 0.5 * box[3], 0.5 * box[4]
    a, b = jackal.BODY_HALF_LENGTH, jackal.BODY_HALF_WIDTH
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
        gap = px * ex + py * ey
        if gap < 0.0:
            ex, ey, gap = -ex, -ey, -gap
        reach = (a * abs(ex) + b * abs(ey) + hx * abs(ax * ex + ay * ey) + hy * abs(ax * ey - ay * ex))
        if reach - gap <= 0.0:
            return -1.0, 0.0, 0.0, 0.0, 0.0
        if reach - gap < depth - 1e-9:
            depth, nx, ny, own = reach - gap, -ex, -ey, k < 2
    if own:                                         # a corner of the box in one of the robot's sides
        i = 1.0 if nx * ax + ny * ay > 0.0 else -1.0
        j = 1.0 if ny * ax - nx * ay > 0.0 else -1.0
        qx, qy = px + i * hx * ax - j * hy * ay, py + i * hx * ay + j * hy * ax
        return depth, min(max(qx, -a), a), min(max(qy, -b), b), nx, ny
    return depth, (-a if nx > 0.0 else a), (-b if ny > 0.0 else b), nx, ny


@njit(cache=True)
def _push(q, px, py, nx, ny, depth, before, give, friction):
    """Move the pose q (x, y, yaw) out of a contact by `depth` along (nx, ny), both in the body's frame, and hold the contact
    point back along the surface by friction. `give`: how easily the body yields ahead, aside and in yaw."""
    arm = px * ny - py * nx
    yield_n = give[0] * nx * nx + give[1] * ny * ny + give[2] * arm * arm
    push = depth / yield_n
    c, s = cos(q[2]), sin(q[2])
    # how far the contact point has slid along the surface in this step
    c0, s0 = cos(before[2]), sin(before[2])
    slid_x = q[0] + c * px - s * py - (before[0] + c0 * px - s0 * py)
    slid_y = q[1] + s * px + c * py - (before[1] + s0 * px + c0 * py)
    tx, ty = -ny, nx
    slid = (c * slid_x + s * slid_y) * tx + (c * slid_y - s * slid_x) * ty
    arm_t = px * ty - py * tx
    yield_t = give[0] * tx * tx + give[1] * ty * ty + give[2] * arm_t * arm_t
    hold = min(max(-slid / yield_t, -friction * push), friction * push)
    fx, fy = push * nx + hold * tx, push * ny + hold * ty
    bx, by = give[0] * fx, give[1] * fy
    q[0] += c * bx - s * by
    q[1] += s * bx + c * by
    q[2] += give[2] * (push * arm + hold * arm_t)


@njit(cache=True)
def drive(state, steps, times, targets, circles, boxes, p, noise, friction):
    """Advance `state` (SIZE,) by `steps` steps of STEP.

    times, targets: step indices (k,) from which the velocity targets (k, 2) hold. circles (n, 3), boxes (m, 5): what may be
    hit. p: the parameters; noise (steps, 3) standard normal; friction multiplies the wheels' friction.
    """
    (lag_v, lag_w, gain_v, gain_w, centre, skew, drop, slip_u, slip_s, slip_w, slip_time,
     give_y, give_w, rub, regain) = p
    give = np.array([1.0, give_y, give_w])
    q, before = np.empty(3), np.empty(3)
    reach = hypot(jackal.BODY_HALF_LENGTH, jackal.BODY_HALF_WIDTH)
    span = reach + steps * STEP * jackal.MAX_SPEED + 0.05
    near = np.empty(circles.shape[0], dtype=np.int64)
    n_near = 0
    for k in range(circles.shape[0]):
        dx, dy, far = circles[k, 0] - state[X], circles[k, 1] - state[Y], circles[k, 2] + span
        if dx * dx + dy * dy < far * far:
            near[n_near] = k
            n_near += 1
    keep, shake = exp(-STEP / slip_time), sqrt(1.0 - exp(-2.0 * STEP / slip_time))
    ease_v, ease_w = 1.0 - exp(-STEP / lag_v), 1.0 - exp(-STEP / lag_w)
    grip = sqrt(friction)
    contact = False
    u_start = state[U]
    k_target = 0
    for step in range(steps):
        while k_target + 1 < times.shape[0] and times[k_target + 1] <= step:
            k_target += 1
        v_goal, w_goal = targets[k_target, 0], targets[k_target, 1]
        state[RAMP_V] = _ramp(state[RAMP_V], v_goal, jackal.MAX_ACCELERATION * STEP)
        state[RAMP_W] = _ramp(state[RAMP_W], w_goal, jackal.MAX_YAW_ACCELERATION * STEP)
        for i in range(3):
            state[SLIP_U + i] = keep * state[SLIP_U + i] + shake * noise[step, i]
        ramp_v, ramp_w = state[RAMP_V], state[RAMP_W]
        effort = abs(ramp_v) + 0.2 * abs(ramp_w)      # a standing robot does not slip
        state[WHEEL_V] = ramp_v
        goal_u = gain_v * ramp_v - drop * abs(ramp_w) * ramp_v + slip_u * effort * state[SLIP_U]
        goal_w = gain_w * ramp_w + slip_w * (abs(ramp_w) + 0.3 * abs(ramp_v)) * state[SLIP_W]
        state[U] += ease_v * grip * (goal_u - state[U])
        state[W] += ease_w * grip * (goal_w - state[W])
        state[S] = -centre * state[W] + skew * abs(state[W]) + slip_s * abs(state[W]) * state[SLIP_S]
        before[0], before[1], before[2] = state[X], state[Y], state[YAW]
        middle = state[YAW] + 0.5 * STEP * state[W]
        c, s = cos(middle), sin(middle)
        q[0] = state[X] + STEP * (c * state[U] - s * state[S])
        q[1] = state[Y] + STEP * (s * state[U] + c * state[S])
        q[2] = state[YAW] + STEP * state[W]
        touched = False
        for sweep in range(3):
            moved = False
            for i in range(n_near):
                k = near[i]
                far = circles[k, 2] + reach
                dx, dy = circles[k, 0] - q[0], circles[k, 1] - q[1]
                if dx * dx + dy * dy < far * far:
                    depth, px, py, nx, ny = _circle_contact(q[0], q[1], cos(q[2]), sin(q[2]),
                                                            circles[k, 0], circles[k, 1], circles[k, 2])
                    if depth > 0.0:
                        _push(q, px, py, nx, ny, depth, before, give, rub)
                        moved = True
            for k in range(boxes.shape[0]):
                far = 0.5 * hypot(boxes[k, 3], boxes[k, 4]) + reach
                dx, dy = boxes[k, 0] - q[0], boxes[k, 1] - q[1]
                if dx * dx + dy * dy < far * far:
                    depth, px, py, nx, ny = _box_contact(q[0], q[1], cos(q[2]), sin(q[2]), boxes[k])
                    if depth > 0.0:
                        _push(q, px, py, nx, ny, depth, before, give, rub)
                        moved = True
            touched |= moved
            if not moved:
                break
        if touched:                                   # the body moves as the contact let it
            contact = True
            c, s = cos(before[2]), sin(before[2])
            dx, dy = (q[0] - before[0]) / STEP, (q[1] - before[1]) / STEP
            state[U] += regain * (c * dx + s * dy - state[U])
            state[S] = c * dy - s * dx
            state[W] += regain * ((q[2] - before[2]) / STEP - state[W])
        state[X], state[Y] = q[0], q[1]
        state[YAW] = atan2(sin(q[2]), cos(q[2]))
    state[CONTACT] = 1.0 if contact else 0.0
    state[ACCEL] = (state[U] - u_start) / (steps * STEP)
