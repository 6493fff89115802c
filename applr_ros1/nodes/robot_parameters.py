"""The nodes' private parameters ~robot, ~map and ~tf_prefix.

Also the parameters of move_base from the robot's files.
"""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

from applr_ros1.common.arguments import frame_prefix
from applr_ros1.common.trees import merged
from applr_ros1.robots import JACKAL, Robot, load

NAMING = ("robot", "map", "tf_prefix")
# Parameters of move_base whose value is a frame
FRAMES = ("robot_base_frame", "sensor_frame", "global_frame", "global_frame_id")


def named_robot(parameters: Dict[str, Any]) -> Tuple[Robot, str]:
    """Return the robot named by the private parameters of a node, and the prefix of its frames.

    Args:
        parameters: `robot` is the name or folder of a description, `map` selects its files for
            driving on a map, and `tf_prefix` is the prefix of its frames.

    Raises:
        RobotError: The description has errors. The message has one line per error.
        ApplrError: There is no such robot, or it has no files for driving on a map.
    """
    # The parameter server may hold a name such as 2 as a number.
    name = str(parameters.get("robot", JACKAL.name))
    robot = load(name, with_map=bool(parameters.get("map", False)))
    return robot, frame_prefix(str(parameters.get("tf_prefix", "")))


def with_robot(parameters: Dict[str, Any]) -> Tuple[Dict[str, Any], Optional[Robot]]:
    """Return the parameter tree of move_base, and the robot.

    Errors are those of `named_robot`.

    Args:
        parameters: The private parameters. All except NAMING override the robot's files.

    Returns:
        The nested tree without NAMING, and the Robot, or None if no robot is named.
    """
    tree = {name: value for name, value in parameters.items() if name not in NAMING}
    if not parameters.get("robot"):
        return tree, None
    robot, prefix = named_robot(parameters)
    files = robot.parameters(bool(parameters.get("map", False)))
    if prefix:
        _prefix_frames(files, prefix)
    return merged(files, tree), robot


def _prefix_frames(tree: Dict[str, Any], prefix: str) -> None:
    """Add the prefix to all frames of the robot in a tree. All robots share the frame `map`."""
    for name, value in tree.items():
        if isinstance(value, dict):
            _prefix_frames(value, prefix)
        elif name in FRAMES and value and value != "map":
            tree[name] = prefix + str(value).lstrip("/")
