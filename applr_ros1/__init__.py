"""APPLR for ROS 1: a move_base-compatible planner, the parameter policy that tunes it, and their nodes.

The generated `applr_ros1.cfg` package lives in the catkin workspace; extending `__path__` lets it be found
when the repository's root comes first on `sys.path`.
"""

import pkgutil

__path__ = pkgutil.extend_path(__path__, __name__)


def load_policy(robot="jackal", file=""):
    """A policy with `predict(observation)`, as stable-baselines3 has it; arguments and errors are those of Predictor.

    What it needs is imported at the first call, so that `import applr_ros1` takes no time.
    """
    from applr_ros1.policy.predictor import Predictor

    return Predictor(robot, file)
