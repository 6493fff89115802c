"""APPLR for ROS 1: a move_base-compatible planner, the policy that tunes it, and their nodes.

The generated `applr_ros1.cfg` package lives in the catkin workspace. `__path__` is extended so that
it is found even if the repository's root comes first on `sys.path`.
"""

import importlib
import os
import pkgutil
import re
import typing

__version__: str  # from __getattr__
__path__ = pkgutil.extend_path(__path__, __name__)


if not typing.TYPE_CHECKING:  # A module with __getattr__ would hide unknown attributes from mypy.

    def __getattr__(name: str) -> str:
        if name != "__version__":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        for file in (os.path.join(os.path.dirname(folder), "package.xml") for folder in __path__):
            if os.path.isfile(file):  # Only a clone has package.xml there.
                with open(file, encoding="utf-8") as manifest:
                    return re.search("<version>(.*)</version>", manifest.read())[1]
        return importlib.import_module("importlib.metadata").version(__name__)


def load_policy(robot: typing.Any = "jackal", file: str = "") -> typing.Any:
    """Load a policy for one robot, with the `predict(observation)` of a stable-baselines3 model.

    Dependencies are imported at the first call to keep `import applr_ros1` fast.

    Args:
        robot: Name of an included robot, or folder with robot.yaml.
        file: Path of a policy that ./applr train wrote; "" for the one in the robot's folder.

    Returns:
        The policy.actor.Policy. Its `environment` holds the arguments for gymnasium.make.

    Raises:
        ApplrError: There is no such robot, or the file does not fit the robot.
    """
    from os import fspath

    from applr_ros1 import robots
    from applr_ros1.policy import actor, methods

    described = robots.load(fspath(robot))
    return actor.load(file or methods.shipped(methods.POLICY, described), described)
