"""Compiles (or loads) the kernels of the collision monitor before it has to check a command.

Called by the collision monitor's node and by whoever compiles everything beforehand (nodes/tools/compile_kernels.py).
"""

import numpy as np

from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.planner.costmap.scan import LaserScan


def warm_up(settings: MonitorSettings) -> None:
    """Give a throw-away monitor two scans and commands; nothing returns from a wide sector of the second one."""
    monitor = CollisionMonitor(settings)
    ranges = np.full(8, 0.6)
    for stamp in (0.0, 0.1):
        monitor.see(LaserScan(stamp, -1.0, 0.3, 0.1, 10.0, ranges, (0.1, 0.0, 0.0)))
        ranges = np.where(np.arange(8) < 4, ranges, np.inf)
        monitor.filter(stamp, (0.0, 0.0, 0.0), (0.5, 0.0), (1.0, 0.1))
