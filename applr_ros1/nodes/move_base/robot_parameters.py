"""The move_base node's parameters where ~robot names a robot: its own files, and what is given beside them on top.

Called by move_base/node.py.
"""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

from applr_ros1.common.arguments import frame_prefix
from applr_ros1.common.trees import merged
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.robots import Robot, load

NAMING = ("robot", "map", "tf_prefix")


def with_robot(given: Dict[str, Any]) -> Tuple[Dict[str, Any], Optional[Robot]]:
    """Return the parameter tree of move_base, and the robot.

    Args:
        given: the private parameters. `robot` is the name or the folder of a description; `map` chooses its files for a
            map; `tf_prefix` goes before the names of its frames. All others replace what the files say.

    Returns:
        The nested tree without these three, and the Robot; None where no robot is named.

    Raises:
        ParameterError: `map` or `tf_prefix` is of no use.
        RobotError: Its folder has errors; a line for each.
        ApplrError: There is no such robot, or it has no files for a map.
    """
    tree = {name: value for name, value in given.items() if name not in NAMING}
    if not given.get("robot"):
        return tree, None
    with_map, prefix = given.get("map", False), frame_prefix(str(given.get("tf_prefix", "")))
    if not isinstance(with_map, bool):
        raise ParameterError(f"map is {with_map!r}: give true or false")
    robot = load(str(given["robot"]), with_map=with_map)
    files = robot.parameters(with_map)
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
