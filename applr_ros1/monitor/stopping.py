"""How much of a command leaves room to stop: the geometry of the collision monitor, in numba.

The base is assumed to follow the command for a reaction time and then to brake along the same arc. The body, a convex
outline widened by a margin, must not touch any point on the way.
"""

import math

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.kernels import kernel

STEP = 0.02  # [s] between two checked poses ...
SHORTEST = 0.01  # ... or where the body moves less than this in a step [m], farther apart
DEEPER = 1e-3  # [m]: a point that is inside the margin from the beginning may not come nearer than this
HALVINGS = 5  # of the interval in which the largest safe factor is searched


def half_planes(outline):
    """The convex hull of an outline (n, 2) [m] as half planes (k, 3): a x + b y <= c inside, (a, b) of length one.

    Raises ApplrError for fewer than three points, points on one line, or points that are not finite.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        equations = ConvexHull(np.asarray(outline, dtype=np.float64)).equations
    except (QhullError, ValueError):
        raise ApplrError("outline of the body: give three points (x, y) or more in metres, not on one line") from None
    return np.ascontiguousarray(np.column_stack((equations[:, :2], -equations[:, 2])))


@kernel
def penetration(planes, margin, x, y):
    """How deep a point [m] lies inside the widened body; negative outside."""
    depth = np.inf
    for k in range(planes.shape[0]):
        depth = min(depth, planes[k, 2] + margin - planes[k, 0] * x - planes[k, 1] * y)
    return depth


@kernel
def safe_scale(points, planes, margin, twist, command, reaction, brake):
    """The largest factor for a command after which the base can still stop freely, and whether braking now is free.

    Args:
        points: (n, 2) obstacle points in the robot's frame [m].
        planes: (k, 3) half planes of the body (half_planes).
        margin: distance [m] by which the body is widened.
        twist: measured (v, w) [m/s, rad/s].
        command: (v, w) asked for.
        reaction: time [s] for which the base follows the command before it brakes.
        brake: (deceleration [m/s^2], angular deceleration [rad/s^2]).

    Returns:
        (scale in [0, 1], free): scale * command is allowed; free is False where not even 0 is.
    """
    before = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        before[i] = max(0.0, penetration(planes, margin, points[i, 0], points[i, 1]))
    if _is_free(points, before, planes, margin, twist, command, 1.0, reaction, brake):
        return 1.0, True
    if not _is_free(points, before, planes, margin, twist, command, 0.0, reaction, brake):
        return 0.0, False
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _is_free(points, before, planes, margin, twist, command, middle, reaction, brake):
            low = middle
        else:
            high = middle
    return low, True


@kernel
def _towards(value, target, change):
    return min(max(target, value - change), value + change)


@kernel
def _is_free(points, before, planes, margin, twist, command, scale, reaction, brake):
    """Whether the body meets nothing while the base takes scale * command, and brakes after the reaction time."""
    v, w = twist
    want_v, want_w = scale * command[0], scale * command[1]
    x = y = yaw = 0.0
    left = reaction
    while True:
        if left > 0.0:
            # the base gains speed at once, the worst case; it loses speed no faster than it can brake
            v = want_v if abs(want_v) >= abs(v) and want_v * v >= 0.0 else _towards(v, want_v, brake[0] * STEP)
            w = want_w if abs(want_w) >= abs(w) and want_w * w >= 0.0 else _towards(w, want_w, brake[1] * STEP)
            left -= STEP
        else:
            steps = max(abs(v) / brake[0], abs(w) / brake[1]) / STEP
            if steps <= 1.0:
                return True
            v -= v / steps
            w -= w / steps
        x += v * STEP * math.cos(yaw + 0.5 * w * STEP)
        y += v * STEP * math.sin(yaw + 0.5 * w * STEP)
        yaw += w * STEP
        c, s = math.cos(yaw), math.sin(yaw)
        for i in range(points.shape[0]):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            if penetration(planes, margin, c * dx + s * dy, c * dy - s * dx) > before[i] + DEEPER:
                return False
