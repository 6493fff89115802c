"""A method that commands velocities: it steers for a point of the global plan, slower where something is ahead."""

import math

import numpy as np


class Pursuit:
    """Pure pursuit of the global plan, ten commands a second.

    Args:
        text: What stands after the second colon of `pursuit.py:Pursuit:text`: the largest speed [m/s].
    """

    period = 0.1
    lookahead = 0.6  # m along the plan

    def __init__(self, text: str = "0.8"):
        self.fastest = float(text)

    def command(self, context):
        """The velocity (v [m/s], w [rad/s]) until the next command."""
        if not len(context.plan):
            return 0.0, 0.0
        x, y, yaw = context.pose
        away = np.hypot(context.plan[:, 0] - x, context.plan[:, 1] - y)
        target = context.plan[np.argmax(away > self.lookahead) if away.max() > self.lookahead else -1]
        angle = math.remainder(math.atan2(target[1] - y, target[0] - x) - yaw, 2.0 * math.pi)
        ahead = context.ranges[300:420].min()  # 45 degrees about straight ahead
        v = min(self.fastest, max(0.15, 0.8 * (ahead - 0.35))) * max(0.0, math.cos(angle)) ** 2
        return v, max(-1.5, min(1.5, 2.5 * angle))
