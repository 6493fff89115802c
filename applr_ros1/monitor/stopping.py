"""Share of a command that leaves room to stop: the geometry of the collision monitor, in numba.

The base is assumed to go on as measured for as long as its pose is old, to follow the command for a reaction time, with
its turn as commanded, faster, still as measured or not at all, and then to brake along the same arc, its last .3 m/s
gently. A stop brakes at once, along the arc that the base is on. On the way the body, a convex outline widened by a
margin, must not touch any point, and the outline itself must not enter a cell that nobody has seen. At the end the
outline may swing, since wheels that nearly stand hold unequally.
"""

import math

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.known_space import CELL_M

CHECK_STEP_S = 0.02  # [s] between two checked poses
# A base that nearly stands has less grip than the braking that was measured from full speed says: below this speed the
# Jackal on Gazebo's ground, which holds or not by the angle at which its wheels stand, loses .3 to .6 m/s each second.
LAST_SPEED_M_S = 0.3
LAST_DECELERATION_M_S2 = 0.6
# By so much such a base turns by itself meanwhile, at most in 98 of 100 stops there, and once in Gazebo.
SWING_RAD = 0.15
AS_MEASURED = -1.0  # for `share`: the base turns as it was measured to
DEEPER_M = 1e-3  # [m]: a point that is inside the margin from the beginning may not come nearer than this
HALVINGS = 5  # of the interval in which the largest safe factor is searched
# [m]: a cell that the body has touched counts as seen all over, so that more must be seen than it needs
BEYOND_M = 1.5 * CELL_M
EVERYTHING = np.ones((1, 1), np.uint8), 0, 0, np.empty((0, 2)), (0.0, 0.0, 0.0)  # for `seen`: all space is known


def half_planes(outline):
    """Return the hull of an outline (n, 2) [m] as half planes (k, 3): a x + b y <= c inside, (a, b) of length one.

    Raises ApplrError for fewer than three points, points on one line, or points that are not finite.
    """
    equations = _hull(outline).equations
    return np.ascontiguousarray(np.column_stack((equations[:, :2], -equations[:, 2])))


def edge_points(outline):
    """Return points (n, 2) [m] all along the convex hull of an outline, less than a cell of SeenSpace apart."""
    corners = np.asarray(outline, dtype=np.float64)[_hull(outline).vertices]
    edges = zip(corners, np.roll(corners, -1, axis=0))
    return np.concatenate([np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / CELL_M))[1:] for a, b in edges])


def _hull(outline):
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(np.asarray(outline, dtype=np.float64).reshape(len(outline), 2))
    except (QhullError, TypeError, ValueError):
        raise ApplrError("outline of the body: give three points (x, y) or more in metres, not on one line") from None


@kernel
def penetration(planes, margin, x, y):
    """Return how deep a point [m] lies inside the widened body; negative outside."""
    depth = np.inf
    for k in range(planes.shape[0]):
        depth = min(depth, planes[k, 2] + margin - planes[k, 0] * x - planes[k, 1] * y)
    return depth


@kernel
def safe_scale(points, planes, margin, twist, command, times, brake, seen, turns=(0.0, 1.0, 0.0, 0.0)):
    """Return the largest factor of a command after which the base can still stop freely; whether braking now is free.

    Args:
        points: (n, 2) obstacle points in the robot's frame [m].
        planes: (k, 3) half planes of the body (half_planes).
        margin: distance [m] by which the body is widened.
        twist: measured (v, w) [m/s, rad/s].
        command: (v, w) asked for.
        times: (age of the robot's frame [s], time [s] for which the base follows the command before it brakes).
        brake: (deceleration [m/s^2] down to LAST_SPEED_M_S, angular deceleration [rad/s^2]).
        seen: (cells, first and second of corner, of SeenSpace; edge_points of the body; robot's (x, y, yaw) in the
            frame of the cells), or EVERYTHING.
        turns: (turn rate [rad/s] that the base was given last, see on_arc; how many times as fast as commanded it may
            turn; how far [m] ahead of its origin the point lies about which it turns; speed [m/s] at which it slides to
            the left beyond what such a turn makes it).

    Returns:
        (scale in [0, 1], free): scale * command is allowed; free is False where not even 0 is.
    """
    # of the points: x, y, the depths that are allowed in the widened body and in the outline; room for _is_deeper
    rows = np.empty((7, points.shape[0]))
    for i in range(points.shape[0]):
        rows[0, i], rows[1, i] = points[i]
        depth = penetration(planes, 0.0, points[i, 0], points[i, 1])
        rows[2, i], rows[3, i] = max(0.0, depth + margin) + DEEPER_M, max(0.0, depth) + DEEPER_M
    if _is_free_every_way(rows, planes, margin, twist, command, 1.0, times, brake, seen, turns):
        return 1.0, True
    if not _is_free(rows, planes, margin, twist, command, 0.0, times, brake, seen, AS_MEASURED, turns):
        return 0.0, False
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _is_free_every_way(rows, planes, margin, twist, command, middle, times, brake, seen, turns):
            low = middle
        else:
            high = middle
    return low, True


def braking_time(speed, deceleration):
    """Return the time [s] in which the base brakes from a speed [m/s] at least 0, its last part gently."""
    last = min(speed, LAST_SPEED_M_S)
    return (speed - last) / deceleration + last / min(deceleration, LAST_DECELERATION_M_S2)


@kernel
def on_arc(v, command_v, command_w, turned):
    """Return the turn rate that keeps a base, faster than commanded at v, on the command's arc; command_v not 0.

    No larger than the larger of the commanded one and the one given before, `turned`. [m/s, rad/s]
    """
    w = min(abs(command_w * v / command_v), max(abs(command_w), abs(turned)))
    return math.copysign(w, command_w)


@kernel
def _is_free_every_way(rows, planes, margin, twist, command, scale, times, brake, seen, turns):
    """Return whether a command is free however much of its turn the base makes.

    As commanded at once, faster, still as measured, or none: a base that brakes may leave the arc outwards.
    """
    for k, share in enumerate((1.0, turns[1], AS_MEASURED, 0.0)):
        repeats = (k == 1 and share == 1.0) or (k == 3 and command[1] == 0.0)
        if not (repeats or _is_free(rows, planes, margin, twist, command, scale, times, brake, seen, share, turns)):
            return False
    return True


@kernel
def _is_free(rows, planes, margin, twist, command, scale, times, brake, seen, share, turns):
    """Return whether the body meets nothing while the base goes on, takes scale * command, and then brakes.

    share: how many times as fast as commanded it turns during the reaction, or AS_MEASURED. A scale of 0 brakes at
    once. Sideways it moves as a turn about the stated point makes it, and slides on as it was measured to beyond that;
    where it turns faster than commanded its tyres hold.
    """
    v, w = twist
    turned, _, ahead, slide = turns
    if share > 1.0:
        slide = 0.0
    want_v, want_w = scale * command[0], scale * command[1]
    x = y = yaw = fastest = 0.0
    since, left = times[0], times[1] if scale > 0.0 else 0.0
    while True:
        step = CHECK_STEP_S
        if since > 0.0:
            step = min(since, CHECK_STEP_S)
            since -= CHECK_STEP_S
        elif left > 0.0:
            # the base gains speed at once, the worst case; it loses speed no faster than it can brake
            change = brake[0] * CHECK_STEP_S
            v = want_v if abs(want_v) >= abs(v) and want_v * v >= 0.0 else min(max(want_v, v - change), v + change)
            if share != AS_MEASURED:
                falls = want_v * v > 0.0 and abs(v) > abs(want_v)
                w = share * (on_arc(v, want_v, want_w, turned) if falls else want_w)
            left -= CHECK_STEP_S
        else:
            # no step goes far below LAST_SPEED_M_S
            gently = max(LAST_DECELERATION_M_S2, (abs(v) - LAST_SPEED_M_S) / CHECK_STEP_S)
            deceleration = min(brake[0], gently)
            steps = max(abs(v) / deceleration, abs(w) / brake[1]) / CHECK_STEP_S
            if steps <= 1.0:
                swing = SWING_RAD * min(fastest / LAST_SPEED_M_S, 1.0)
                return _is_seen_beyond(seen, x, y, yaw, want_v, want_w) and _may_swing(
                    rows, planes, ahead, x, y, yaw, swing
                )
            fastest = max(fastest, abs(v))
            v -= v / steps
            w -= w / steps
            slide -= slide / steps
        aside = slide - ahead * w
        c, s = math.cos(yaw + 0.5 * w * step), math.sin(yaw + 0.5 * w * step)
        x += (v * c - aside * s) * step
        y += (v * s + aside * c) * step
        yaw += w * step
        c, s = math.cos(yaw), math.sin(yaw)
        if _is_deeper(rows, rows[2], planes, margin, x, y, c, s) or not _is_seen(seen, x, y, c, s):
            return False


@kernel
def _is_deeper(rows, limits, planes, margin, x, y, c, s):
    """Return whether any point's penetration() is above its limit with the body at (x, y, cosine, sine of yaw).

    All points are looked at, plane by plane: such loops compile to vector instructions.
    """
    xs, ys, ahead, aside, depth = rows[0], rows[1], rows[4], rows[5], rows[6]
    for i in range(xs.shape[0]):
        dx, dy = xs[i] - x, ys[i] - y
        ahead[i], aside[i], depth[i] = c * dx + s * dy, c * dy - s * dx, np.inf
    for k in range(planes.shape[0]):
        a, b, most = planes[k, 0], planes[k, 1], planes[k, 2] + margin
        for i in range(xs.shape[0]):
            depth[i] = min(depth[i], most - a * ahead[i] - b * aside[i])
    deeper = False
    for i in range(xs.shape[0]):
        deeper |= depth[i] > limits[i]
    return deeper


@kernel
def _may_swing(rows, planes, ahead, x, y, yaw, swing):
    """Return whether the outline may turn by `swing` [rad] to both sides about its point ahead, at rest at a pose."""
    if swing == 0.0:
        return True
    px, py = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
    for turn in (yaw - swing, yaw + swing):
        c, s = math.cos(turn), math.sin(turn)
        if _is_deeper(rows, rows[3], planes, 0.0, px - ahead * c, py - ahead * s, c, s):
            return False
    return True


@kernel
def _is_seen(seen, x, y, c, s):
    """Return whether all of the body's edge lies in seen cells when the body is at (x, y, cosine, sine of yaw)."""
    cells, corner_i, corner_j, edge, pose = seen
    n = cells.shape[0]
    pc, ps = math.cos(pose[2]), math.sin(pose[2])
    first_i, first_j = corner_i % n, corner_j % n
    for k in range(edge.shape[0]):
        ex, ey = x + c * edge[k, 0] - s * edge[k, 1], y + s * edge[k, 0] + c * edge[k, 1]
        i = int(math.floor((pose[0] + pc * ex - ps * ey) / CELL_M)) - corner_i
        j = int(math.floor((pose[1] + ps * ex + pc * ey) / CELL_M)) - corner_j
        if not (0 <= i < n and 0 <= j < n):
            return False
        i, j = i + first_i, j + first_j  # less than 2 n: without a slow division
        if not cells[i - n if i >= n else i, j - n if j >= n else j]:
            return False
    return True


@kernel
def _is_seen_beyond(seen, x, y, yaw, v, w):
    """Return the same where it would be had its fastest point gone on by BEYOND_M; True for a base that is to stand."""
    fastest = 0.0
    for k in range(seen[3].shape[0]):
        fastest = max(fastest, math.hypot(v - w * seen[3][k, 1], w * seen[3][k, 0]))
    if fastest == 0.0:
        return True
    time = BEYOND_M / fastest
    x += v * time * math.cos(yaw + 0.5 * w * time)
    y += v * time * math.sin(yaw + 0.5 * w * time)
    yaw += w * time
    return _is_seen(seen, x, y, math.cos(yaw), math.sin(yaw))
