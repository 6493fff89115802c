"""Frame of the poses that scan matching has corrected, for a planner whose costmaps are in it.

CollisionMonitor holds one MatchedFrame. Where hardly anything stands, scans are matched to what
moves, and before a bare wall hardly anything tells how far the robot slides along it: among moving
obstacles in an empty hall the matcher's correction was off by metres, the odometry by decimetres.
For the monitor, which remembers for seconds, that matters little; maps and goal of a planner would
be spoilt. The frame therefore takes only corrections by scans that show enough in each direction
and nothing that moves. Otherwise it goes on with the odometry.
"""

from applr_ros1.common.angles import Pose, compose, inverse
from applr_ros1.monitor.scan_matching import ScanMatcher

# Smallest support of a correction (ScanMatcher.support). Among the posts of BARN's worlds it is .15
# to .4 in nine of ten scans, in the hall at most .08.
SUPPORT = 0.1


class MatchedFrame:
    """Frame that follows the matcher's corrections as far as they are well supported.

    Attributes:
        correction: Pose (x, y, yaw) [m, m, rad] of the odometry's frame in this one.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin at the odometry's frame."""
        self.correction: Pose = (0.0, 0.0, 0.0)

    def follow(self, matcher: ScanMatcher, before: Pose) -> None:
        """Take over what a scan in which nothing moves has changed.

        Args:
            matcher: Matcher after this scan.
            before: Its correction before.
        """
        if matcher.support < SUPPORT:
            return
        change = compose(inverse(before), matcher.correction)
        self.correction = compose(self.correction, change)
