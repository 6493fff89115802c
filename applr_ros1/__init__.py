"""APPLR for ROS 1: a move_base-compatible planner, the parameter policy that tunes it, and their nodes.

The generated `applr_ros1.cfg` package lives in the catkin workspace; extending `__path__` lets it be found
when the repository's root comes first on `sys.path`.
"""

import pkgutil

__path__ = pkgutil.extend_path(__path__, __name__)
