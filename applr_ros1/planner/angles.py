"""Angles as C++ ROS handles them, to the last bit: through quaternions, and their differences. Small turns, quickly.

Called by both local planners.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel

LARGEST_TURN = 0.5  # [rad] a step for closed forms: the chord's formula fails near a full turn


@kernel
def normalize_angle(yaw):
    """An angle after its way through a quaternion: in (-pi, pi], last bits may differ."""
    z = math.sin(yaw / 2)
    w = math.cos(yaw / 2)
    return math.atan2(2 * (w * z), w * w - z * z)


@kernel
def angle_difference(a, b):
    """The angle from a to b, in (-pi, pi]."""
    r = np.fmod(b - a + math.pi, 2.0 * math.pi)
    return r + math.pi if r <= 0.0 else r - math.pi


@kernel
def small_turn(a):
    """(cos a, sin a) by their series, for |a| <= .25 good to about 1e-15."""
    t = a * a
    return (
        1 - t / 2 * (1 - t / 12 * (1 - t / 30 * (1 - t / 56))),
        a * (1 - t / 6 * (1 - t / 20 * (1 - t / 42 * (1 - t / 72)))),
    )
