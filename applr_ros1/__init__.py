"""APPLR for ROS 1: a move_base-compatible planner, the parameter policy that tunes it, and their nodes.

The generated `applr_ros1.cfg` package lives in the catkin workspace; extending `__path__` lets it be found
when the repository's root comes first on `sys.path`.
"""

import pkgutil

__path__ = pkgutil.extend_path(__path__, __name__)


def load_policy(robot="jackal", file=""):
    """A policy that drives one robot, with `predict(observation)` as a model of stable-baselines3 has it.

    What it needs is imported at the first call, so that `import applr_ros1` takes no time.

    Args:
        robot: Name of an included robot, or folder with robot.yaml.
        file: Of a policy that train.py wrote; "" for the included one.

    Returns:
        A policy.actor.Policy; its `environment` is what gymnasium.make has to be given.

    Raises:
        ApplrError: There is no such robot, or the file cannot be used for it.
    """
    from os import fspath

    from applr_ros1 import robots
    from applr_ros1.policy import actor, methods

    described = robots.load(fspath(robot))
    return actor.load(file or methods.shipped(robot=described), described)
