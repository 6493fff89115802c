"""Angles as C++ ROS handles them, to the last bit: through quaternions, and their differences.

Called by both local planners.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel


@kernel
def wrapped(yaw):
    """An angle after its way through a quaternion: in (-pi, pi], last bits may differ."""
    z = math.sin(yaw / 2)
    w = math.cos(yaw / 2)
    return math.atan2(2 * (w * z), w * w - z * z)


@kernel
def angle_difference(a, b):
    """The angle from a to b, in (-pi, pi]."""
    r = np.fmod(b - a + math.pi, 2.0 * math.pi)
    return r + math.pi if r <= 0.0 else r - math.pi
