"""The nodes' private parameters ~robot, ~map and ~tf_prefix, ~method and ~matched of move_base.

Also the parameters of move_base from the robot's files.
"""

from __future__ import annotations

from typing import Optional, Tuple

from applr_ros1.common.arguments import frame_prefix
from applr_ros1.planner.parameters.trees import Tree, merged, without_empty
from applr_ros1.policy import methods
from applr_ros1.robots import JACKAL, Robot, load

NAMING = ("robot", "map", "tf_prefix")
# Parameters of the node move_base that are not parameters of the planner
STARTING = (*NAMING, "method", "matched")
# Parameters of move_base whose value is a frame
FRAMES = ("robot_base_frame", "sensor_frame", "global_frame", "global_frame_id")


def named_robot(parameters: Tree) -> Tuple[Robot, str]:
    """Return the robot named by the private parameters of a node, and the prefix of its frames.

    Args:
        parameters: `robot` is the name or folder of a description, `map` selects its files for
            driving on a map, and `tf_prefix` is the prefix of its frames.

    Raises:
        RobotError: The description has errors. The message has one line per error.
        ApplrError: There is no such robot, or it has no files for driving on a map.
    """
    # The parameter server may hold a name such as 2 as a number.
    robot_name = str(parameters.get("robot", JACKAL.name))
    robot = load(robot_name, with_map=bool(parameters.get("map", False)))
    prefix = str(parameters.get("tf_prefix", ""))
    return robot, frame_prefix(prefix)


def with_robot(parameters: Tree) -> Tuple[Tree, Optional[Robot]]:
    """Return the parameter tree of move_base, and the robot.

    Errors are those of `named_robot`.

    Args:
        parameters: The private parameters. All except STARTING override the robot's files. With
            `method`, the costmaps mark obstacles up to the range for which this method was made.
            With `matched` and without `map`, both costmaps are in the frame of the collision
            monitor's matched poses.

    Returns:
        The nested tree without STARTING, and the Robot, or None if no robot is named.
    """
    overrides = {name: value for name, value in parameters.items() if name not in STARTING}
    if not parameters.get("robot"):
        return overrides, None
    robot, prefix = named_robot(parameters)
    needed_range = methods.obstacle_range(str(parameters.get("method", "dwa")), robot)
    started_robot = robot.seeing(needed_range)
    if parameters.get("matched", False):
        started_robot = started_robot.in_matched_frame()
    if parameters.get("map", False):  # Raises an error if an included robot has no such files.
        started_robot = started_robot.on_map()
    file_parameters = started_robot.parameters()
    if prefix:
        _prefix_frames(file_parameters, prefix)
    # An empty value of a file stands for the default. The parameter server cannot hold it.
    return without_empty(merged(file_parameters, overrides)), robot


def _prefix_frames(tree: Tree, prefix: str) -> None:
    """Add the prefix to all frames of the robot in a tree. All robots share the frame `map`."""
    for name, value in tree.items():
        if isinstance(value, dict):
            _prefix_frames(value, prefix)
            continue
        # An empty sensor_frame stands for the frame of the messages.
        is_named_frame = name in FRAMES and bool(value)
        if is_named_frame and value != "map":
            frame = str(value).lstrip("/")
            tree[name] = prefix + frame
