"""What the policy sees: s = (o_t, phi_t, theta_{t-1}) (paper, section III-B), every component in [-1, 1].

Called by the applr node, the meta-environment and the bag reader, so that all three see the same vector.
"""

from functools import lru_cache
from math import atan2, cos, pi, sin

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.parameter_space import SPACE

BEAMS = 720
RANGE_CAP = 2.0  # m; the paper caps the scan there
AHEAD, RIGHT, LEFT = slice(300, 420), slice(80, 200), slice(520, 640)  # beams of 45 degrees in these directions
ANGLE_MIN = -2.35619  # rad; 270 degrees in all
ANGLE_TOLERANCE = 0.02  # rad; how far a scanner's first and last beam may be from that
LOOKAHEAD = 1.0  # m; the local goal is the first plan point farther away than this
WINDOW, ORDER = 19, 3  # Savitzky-Golay filter that smooths the plan
SIZE = BEAMS + 1 + len(SPACE)
LAYOUT = {
    "beams": BEAMS,
    "range_cap_m": RANGE_CAP,
    "angle_min_rad": ANGLE_MIN,
    "angle_max_rad": -ANGLE_MIN,
    "order": ["scan", "phi", "theta"],
    "lookahead_m": LOOKAHEAD,
    "size": SIZE,
}


class ObservationError(ApplrError):
    """A scan or plan that no observation can be made of; one line says what, which value and what to do."""


def observe(ranges, phi, theta_prev, space=SPACE):
    """The observation (729,) float32: [720 beams r - 1 with r capped at 2 m; phi / pi; theta_prev scaled].

    Args:
        ranges: (720,) [m]; by REP-117 +inf is no return (2 m) and -inf is too near (0 m). NaN is no measurement and
            takes the value between its valid neighbours.
        phi: angle of the local goal [rad].
        theta_prev: (8,) the parameters that the planner has; beyond the ranges they are clipped.
        space: the parameter space.

    Raises:
        ObservationError: another number of beams, a scan without a valid beam, or a phi that is not finite.
    """
    ranges = np.asarray(ranges, dtype=np.float32)
    if ranges.shape != (BEAMS,):
        raise ObservationError(
            f"scan has {ranges.size} beams: the policy was trained on {BEAMS}; "
            "give a scan of that many over 270 degrees"
        )
    if not np.isfinite(phi):
        raise ObservationError(f"angle of the local goal is {phi}: check the pose and the global plan")
    missing = np.isnan(ranges)
    if missing.any():
        if missing.all():
            raise ObservationError(f"all {BEAMS} beams of the scan are NaN: check the laser")
        index = np.arange(BEAMS)
        ranges = np.where(missing, 0.0, np.clip(ranges, 0.0, RANGE_CAP))
        ranges[missing] = np.interp(index[missing], index[~missing], ranges[~missing])
    result = np.empty(BEAMS + 1 + len(space), dtype=np.float32)
    result[:BEAMS] = np.clip(ranges, 0.0, RANGE_CAP) * (2.0 / RANGE_CAP) - 1.0
    result[BEAMS] = np.clip(phi / pi, -1.0, 1.0)
    result[BEAMS + 1 :] = space.to_action(theta_prev)
    return result


def check_scan(beams, angle_min, angle_increment):
    """Raises ObservationError unless a scanner's geometry is the policy's: 720 beams over +-2.356 rad."""
    if beams != BEAMS:
        raise ObservationError(
            f"scan has {beams} beams: the policy was trained on {BEAMS}; give a scan of that many over 270 degrees"
        )
    angle_max = angle_min + angle_increment * (beams - 1)
    if not (abs(angle_min - ANGLE_MIN) <= ANGLE_TOLERANCE and abs(angle_max + ANGLE_MIN) <= ANGLE_TOLERANCE):
        raise ObservationError(
            f"scan covers {angle_min:.3f} to {angle_max:.3f} rad: the policy was trained "
            f"on {ANGLE_MIN:.3f} to {-ANGLE_MIN:.3f}; cut the scan to that"
        )


def local_goal(plan, pose):
    """The local goal (gx, gy) in the robot's frame [m].

    It is the first point of the smoothed global plan that is more than 1 m away from the robot, or the last point of
    the plan if there is none.

    Args:
        plan: (n, >= 2) x, y [m] in the frame of the pose, start first.
        pose: (x, y, yaw) of the robot [m, rad].

    Raises:
        ObservationError: the plan is empty, or plan or pose is not finite.
    """
    plan = np.asarray(plan, dtype=np.float64)
    if plan.ndim != 2 or len(plan) == 0:
        raise ObservationError("global plan is empty: no local goal until the planner finds a way")
    if not (np.all(np.isfinite(plan[:, :2])) and np.all(np.isfinite(pose))):
        raise ObservationError("global plan or pose is not finite: check odometry and planner")
    points = smooth(plan[:, :2])
    dx, dy = points[:, 0] - pose[0], points[:, 1] - pose[1]
    far = np.flatnonzero(np.hypot(dx, dy) > LOOKAHEAD)
    i = far[0] if len(far) else len(points) - 1
    c, s = cos(pose[2]), sin(pose[2])
    return float(c * dx[i] + s * dy[i]), float(-s * dx[i] + c * dy[i])


def goal_angle(goal):
    """The angle phi = atan2(gy, gx) in [-pi, pi] of a local goal in the robot's frame."""
    return atan2(goal[1], goal[0])


def smooth(points):
    """Savitzky-Golay filter (19, 3) along the columns of points (n, k).

    It equals scipy.signal.savgol_filter with its default edges ("interp": a polynomial through the first and last
    window) within 1e-9 m. It stands here because it takes a twentieth of the time and because importing scipy.signal
    would add about a second to the start of every node and actor. Shorter plans take the largest odd window that fits;
    four points and fewer stay as they are.
    """
    window = min(WINDOW, len(points) if len(points) % 2 else len(points) - 1)
    if window <= ORDER:
        return np.array(points, dtype=np.float64)
    hat, half = _hat(window), window // 2
    result = np.empty(points.shape, dtype=np.float64)
    for k in range(points.shape[1]):
        result[half : len(points) - half, k] = np.convolve(points[:, k], hat[half][::-1], mode="valid")
    result[:half] = hat[:half] @ points[:window]
    result[-half:] = hat[-half:] @ points[-window:]
    return result


@lru_cache(maxsize=None)
def _hat(window):
    """(window, window): row i gives the fitted cubic's value at place i as weights of the window's points."""
    x = np.arange(window, dtype=np.float64) - window // 2
    vandermonde = x[:, None] ** np.arange(ORDER + 1)
    return vandermonde @ np.linalg.pinv(vandermonde)
