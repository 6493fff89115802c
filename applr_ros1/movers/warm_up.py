"""Compiles (or loads) the kernels of the tracker before the first scan comes.

Called by whoever tracks, and by whoever compiles everything beforehand (nodes/tools/compile_kernels.py).
"""

import numpy as np

from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.planner.costmap.scan import LaserScan


def warm_up() -> None:
    """Give a throw-away tracker two scans of a disc that comes nearer."""
    tracker = MoverTracker(1.0, 1.0, 0.1)
    for stamp, distance in ((0.0, 2.0), (0.1, 1.9)):
        ranges = np.where(abs(np.arange(41) - 20) < 8, distance, 5.0)
        tracker.update(LaserScan(stamp, -0.4, 0.02, 0.1, 10.0, ranges, (0.0, 0.0, 0.0)))
