"""The private parameters ~robot, ~map and ~tf_prefix of the nodes, and move_base's parameters by the robot's files."""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

from applr_ros1.common.arguments import frame_prefix
from applr_ros1.common.trees import merged
from applr_ros1.robots import JACKAL, Robot, load

NAMING = ("robot", "map", "tf_prefix")


def named_robot(parameters: Dict[str, Any]) -> Tuple[Robot, str]:
    """Return the robot that the private parameters of a node name, and the prefix of its frames' names.

    Args:
        parameters: `robot` is the name or the folder of a description; `map` chooses its files for a map; `tf_prefix`
            goes before the names of its frames.

    Raises:
        RobotError: Its folder has errors; a line for each.
        ApplrError: There is no such robot, or it has no files for a map.
    """
    robot = load(str(parameters.get("robot", JACKAL.name)), with_map=bool(parameters.get("map", False)))
    return robot, frame_prefix(str(parameters.get("tf_prefix", "")))


def with_robot(given: Dict[str, Any]) -> Tuple[Dict[str, Any], Optional[Robot]]:
    """Return the parameter tree of move_base, and the robot. Raises as `named_robot`.

    Args:
        given: The private parameters. All but those of `named_robot` replace what the robot's files say.

    Returns:
        The nested tree without NAMING, and the Robot; None if no robot is named.
    """
    tree = {name: value for name, value in given.items() if name not in NAMING}
    if not given.get("robot"):
        return tree, None
    robot, prefix = named_robot(given)
    files = robot.parameters(bool(given.get("map", False)))
    if prefix:
        _prefix_frames(files, prefix)
    return merged(files, tree), robot


def _prefix_frames(tree: Dict[str, Any], prefix: str) -> None:
    """Put the prefix before the robot's own frames, wherever they stand; the map is of all robots."""
    for name, value in tree.items():
        if isinstance(value, dict):
            _prefix_frames(value, prefix)
        elif (
            name in ("robot_base_frame", "sensor_frame", "global_frame", "global_frame_id") and value and value != "map"
        ):
            tree[name] = prefix + str(value).lstrip("/")
