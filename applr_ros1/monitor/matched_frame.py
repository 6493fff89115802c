"""Frame of the poses that scan matching has corrected, for a planner whose costmaps are in it.

CollisionMonitor holds one MatchedFrame. Where hardly anything stands, scans are matched to what
moves: among people in an empty hall the matcher's correction was off by metres, the odometry by
decimetres. For the monitor, which remembers for seconds, that matters little; maps and goal of a
planner would be spoilt. The frame therefore takes only corrections by scans in which nothing moves,
and goes on with the odometry in others.
"""

from applr_ros1.common.angles import Pose, compose, inverse


class MatchedFrame:
    """Frame that follows the matcher's corrections while nothing moves.

    Attributes:
        correction: Pose (x, y, yaw) [m, m, rad] of the odometry's frame in this one.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin at the odometry's frame."""
        self.correction: Pose = (0.0, 0.0, 0.0)

    def follow(self, before: Pose, after: Pose) -> None:
        """Take over what a scan has changed, from one correction of the matcher to the next."""
        change = compose(inverse(before), after)
        self.correction = compose(self.correction, change)
