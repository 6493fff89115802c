"""Largest safe scale of a command: the swept-body geometry of the collision monitor, in numba.

The model of the base has three phases. First the base keeps its measured velocity for as long as its pose is old. Then
it follows the command for the reaction time. Its turn rate may be as commanded, higher, as measured, or zero. Last, it
brakes along the same arc, more gently below .3 m/s. A stop brakes at once along the current arc. The body is a convex
outline widened by a margin, and must not touch any obstacle point. The outline itself must not enter unobserved cells.
At the end the base may turn by its yaw swing, because nearly stopped wheels have unequal friction.
"""

import math
from typing import Any, Tuple

import numpy as np
import scipy

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.known_space import CELL_M
from applr_ros1.monitor.motion import Twist

Seen = Tuple[np.ndarray, int, int, np.ndarray, Pose]
Turns = Tuple[float, float, float, float]
Motion = Tuple[np.ndarray, float, Twist, Twist, Twist, Twist, Seen, Turns]  # arguments of safe_scale after the points
Placed = Tuple[float, float, float, float]  # x, y of the body [m], cosine and sine of its yaw

CHECK_STEP_S = 0.02  # interval between two checked poses [s]
# The friction limit falls at low speed, and the braking that was measured from full speed does not include this. Below
# LAST_SPEED_M_S [m/s] the Jackal on Gazebo's ground decelerates by .3 to .6 m/s^2, depending on the wheels' angles.
LAST_SPEED_M_S = 0.3
LAST_DECELERATION_M_S2 = 0.6
# Yaw swing of a base that brakes below LAST_SPEED_M_S [rad]: not exceeded in 98 of 100 simulated stops.
SWING_RAD = 0.15
AS_MEASURED = -1.0  # value of `share` for a base that continues to turn at its measured rate
DEEPER_M = 1e-3  # largest allowed increase of the depth of a point that starts inside the margin [m]
HALVINGS = 5  # number of bisections in the search for the largest safe scale
# Distance past the stopping point that must be observed [m]. Partly observed cells count as observed, hence 1.5 cells.
BEYOND_M = 1.5 * CELL_M
# Value of `seen` if all space is known.
EVERYTHING: Seen = np.ones((1, 1), np.uint8), 0, 0, np.empty((0, 2)), (0.0, 0.0, 0.0)


def half_planes(outline: Any) -> np.ndarray:
    """Return the hull of an outline (n, 2) [m] as half planes (k, 3): a x + b y <= c inside, (a, b) of length one."""
    equations = scipy.spatial.ConvexHull(outline).equations
    return np.ascontiguousarray(np.column_stack((equations[:, :2], -equations[:, 2])))


def edge_points(outline: Any) -> np.ndarray:
    """Return points (n, 2) [m] along the convex hull of an outline, spaced closer than the cells of SeenSpace."""
    corners = np.asarray(outline, dtype=np.float64)[scipy.spatial.ConvexHull(outline).vertices]
    edges = zip(corners, np.roll(corners, -1, axis=0))
    return np.concatenate([np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / CELL_M))[1:] for a, b in edges])


@kernel
def penetration(planes: Array, margin: float, x: float, y: float) -> float:
    """Return the depth of a point inside the widened body [m]; negative outside."""
    depth = np.inf
    for k in range(planes.shape[0]):
        depth = min(depth, planes[k, 2] + margin - planes[k, 0] * x - planes[k, 1] * y)
    return depth


@kernel
def safe_scale(
    points: Array,
    planes: Array,
    margin: float,
    twist: Twist,
    command: Twist,
    times: Tuple[float, float],
    brake: Tuple[float, float],
    seen: Seen,
    turns: Turns = (0.0, 1.0, 0.0, 0.0),
) -> Tuple[float, bool]:
    """Return the largest scale of a command after which the base can still stop without contact.

    Args:
        points: (n, 2) obstacle points in the robot's frame [m].
        planes: (k, 3) half planes of the body (half_planes).
        margin: distance by which the body is widened [m].
        twist: measured (v, w) [m/s, rad/s].
        command: requested (v, w) [m/s, rad/s].
        times: (age of the robot's pose [s], time for which the base follows the command before it brakes [s]).
        brake: (deceleration down to LAST_SPEED_M_S [m/s^2], angular deceleration [rad/s^2]).
        seen: (cells, corner[0] and corner[1] of SeenSpace, edge_points of the body, (x, y, yaw) of the robot in the
            frame of the cells), or EVERYTHING.
        turns: (previous commanded turn rate [rad/s], for on_arc; largest ratio of actual to commanded turn rate;
            distance from the origin forward to the centre of rotation [m]; lateral slip to the left [m/s]).

    Returns:
        (scale in [0, 1], free): scale * command is safe; free is False if even braking at once leads to contact.
    """
    motion = planes, margin, twist, command, times, brake, seen, turns
    # Rows: x and y of the points, their allowed depths in the widened body and in the outline, workspace of _is_deeper.
    rows = np.empty((7, points.shape[0]))
    for i in range(points.shape[0]):
        rows[0, i], rows[1, i] = points[i]
        depth = penetration(planes, 0.0, points[i, 0], points[i, 1])
        rows[2, i], rows[3, i] = max(0.0, depth + margin) + DEEPER_M, max(0.0, depth) + DEEPER_M
    if _is_free_every_way(rows, motion, 1.0):
        return 1.0, True
    if not _is_free(rows, motion, 0.0, AS_MEASURED):
        return 0.0, False
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _is_free_every_way(rows, motion, middle):
            low = middle
        else:
            high = middle
    return low, True


def braking_time(speed: float, deceleration: float) -> float:
    """Return the time [s] to brake from a speed >= 0 [m/s] at a deceleration [m/s^2], gently below LAST_SPEED_M_S."""
    last = min(speed, LAST_SPEED_M_S)
    return (speed - last) / deceleration + last / min(deceleration, LAST_DECELERATION_M_S2)


@kernel
def on_arc(v: float, command_v: float, command_w: float, turned: float) -> float:
    """Return the turn rate [rad/s] that keeps a base at speed v [m/s] on the arc of its command; command_v is not 0.

    The magnitude is at most the larger of command_w and the previous turn rate `turned`.
    """
    w = min(abs(command_w * v / command_v), max(abs(command_w), abs(turned)))
    return math.copysign(w, command_w)


@kernel
def _is_free_every_way(rows: Array, motion: Motion, scale: float) -> bool:
    """Return whether a command is collision-free for every possible response of the turn rate.

    The base may turn as commanded at once, faster, still as measured, or not at all, and thus leave the arc.
    """
    _, _, _, command, _, _, _, turns = motion
    for k, share in enumerate((1.0, turns[1], AS_MEASURED, 0.0)):
        repeats = (k == 1 and share == 1.0) or (k == 3 and command[1] == 0.0)
        if not (repeats or _is_free(rows, motion, scale, share)):
            return False
    return True


@kernel
def _is_free(rows: Array, motion: Motion, scale: float, share: float) -> bool:
    """Return whether the body touches nothing while the base continues, follows scale * command, and then brakes.

    share is the ratio of actual to commanded turn rate during the reaction time, or AS_MEASURED. A scale of 0 brakes at
    once. The lateral velocity is that of a turn about the centre of rotation plus the measured lateral slip. If the
    base turns faster than commanded its tyres must be gripping, so no slip is added.
    """
    planes, margin, (v, w), command, times, brake, seen, (turned, _, ahead, slide) = motion
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
            # Worst case: the base gains speed at once, and loses speed only as fast as it can brake.
            change = brake[0] * CHECK_STEP_S
            v = want_v if abs(want_v) >= abs(v) and want_v * v >= 0.0 else min(max(want_v, v - change), v + change)
            if share != AS_MEASURED:
                falls = want_v * v > 0.0 and abs(v) > abs(want_v)
                w = share * (on_arc(v, want_v, want_w, turned) if falls else want_w)
            left -= CHECK_STEP_S
        else:
            # The deceleration is limited so that no step ends far below LAST_SPEED_M_S.
            gently = max(LAST_DECELERATION_M_S2, (abs(v) - LAST_SPEED_M_S) / CHECK_STEP_S)
            deceleration = min(brake[0], gently)
            steps = max(abs(v) / deceleration, abs(w) / brake[1]) / CHECK_STEP_S
            if steps <= 1.0:
                swing = SWING_RAD * min(fastest / LAST_SPEED_M_S, 1.0)
                beyond = _is_seen_beyond(seen, (x, y, yaw), want_v, want_w)
                return bool(beyond and _may_swing(rows, planes, ahead, (x, y, yaw), swing))
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
        if _is_deeper(rows, rows[2], planes, margin, (x, y, c, s)) or not _is_seen(seen, (x, y, c, s)):
            return False


@kernel
def _is_deeper(rows: Array, limits: Array, planes: Array, margin: float, at: Placed) -> bool:
    """Return whether any point's penetration() is above its limit with the body at `at`.

    The loops run over all points, plane by plane, without an early exit, so that they compile to vector instructions.
    """
    x, y, c, s = at
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
def _may_swing(rows: Array, planes: Array, ahead: float, pose: Pose, swing: float) -> bool:
    """Return whether the outline at a pose may turn by `swing` [rad] to both sides about its centre of rotation."""
    if swing == 0.0:
        return True
    x, y, yaw = pose
    px, py = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
    for turn in (yaw - swing, yaw + swing):
        c, s = math.cos(turn), math.sin(turn)
        if _is_deeper(rows, rows[3], planes, 0.0, (px - ahead * c, py - ahead * s, c, s)):
            return False
    return True


@kernel
def _is_seen(seen: Seen, at: Placed) -> bool:
    """Return whether the body's whole edge lies in observed cells with the body at `at`."""
    x, y, c, s = at
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
        i, j = i + first_i, j + first_j  # Both are below 2 n, so a comparison replaces the slow modulo.
        if not cells[i - n if i >= n else i, j - n if j >= n else j]:
            return False
    return True


@kernel
def _is_seen_beyond(seen: Seen, pose: Pose, v: float, w: float) -> bool:
    """Return whether the space BEYOND_M past the stopping point is observed. True if the command is a stop."""
    fastest = 0.0
    for k in range(seen[3].shape[0]):
        fastest = max(fastest, math.hypot(v - w * seen[3][k, 1], w * seen[3][k, 0]))
    if fastest == 0.0:
        return True
    x, y, yaw = pose
    time = BEYOND_M / fastest
    x += v * time * math.cos(yaw + 0.5 * w * time)
    y += v * time * math.sin(yaw + 0.5 * w * time)
    yaw += w * time
    return bool(_is_seen(seen, (x, y, math.cos(yaw), math.sin(yaw))))
