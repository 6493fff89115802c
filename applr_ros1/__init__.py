"""APPLR for ROS 1: a move_base-compatible planner, the parameter policy that tunes it, and their nodes.

The generated `applr_ros1.cfg` package lives in the catkin workspace; extending `__path__` lets it be found
when the repository's root comes first on `sys.path`.
"""

import pkgutil

from applr_ros1.common import interrupts

__path__ = pkgutil.extend_path(__path__, __name__)

if interrupts.is_starting():  # before anything is imported that takes long
    interrupts.make_quiet()

try:  # gymnasium.make("applr_ros1:applr_ros1/Navigation-v0") imports this package to learn of the environment
    import gymnasium
except ImportError:  # as on a robot, which needs none
    pass
else:
    if "applr_ros1/Navigation-v0" not in gymnasium.registry:
        gymnasium.register("applr_ros1/Navigation-v0", entry_point="training.mdp.env:ApplrEnv")
