"""A parameter set as files: JSON for this package's methods, YAML for any move_base. tune_robot.py writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping

import yaml

from applr_ros1.common.files import write_bytes, write_json
from applr_ros1.common.trees import branch
from applr_ros1.policy.distance_weights import PLANNER
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot

HEAD = """# Parameters of move_base for {robot}, to be loaded after its own files:
#   <rosparam file="{file}" command="load" ns="move_base"/>
# Its distance biases count cells, as the C++ planner does unless it was unlucky at its start
# (docs/howto/cpp_move_base.md).
"""


def write(robot: Robot, values: Mapping[str, Any], as_json: Path, as_yaml: Path) -> None:
    """Writes {name: value} of a set as both files."""
    write_json(as_json, {"meter_scoring": False, "parameters": dict(values)})
    head = HEAD.format(robot=robot.name, file=as_yaml.name)
    write_bytes(as_yaml, (head + yaml.safe_dump(move_base_parameters(robot, values))).encode())


def move_base_parameters(robot: Robot, values: Mapping[str, Any]) -> Dict[str, Any]:
    """A set as the nested parameters of move_base that, loaded after the robot's own files, replace theirs.

    They have the names and places of those files, which may be older ones (robots.robot.number_at).

    Args:
        robot: The robot.
        values: {name: value} of the set; parameters that it leaves out stay out.
    """
    made: Dict[str, Any] = {}
    space, own = space_of(robot), robot.parameters()
    for server, request in space.requests(space.from_dict(dict(values))).items():
        costmap = server.rpartition("/")[0]
        place = costmap if costmap and "plugins" not in branch(own, costmap) else server
        for i, target in space.targets_of(server):
            if space.names[i] not in values:
                continue
            names = [name for name in target.names if name in branch(own, place)] or target.names[:1]
            branch(made, place, create=True).update(dict.fromkeys(names, request[target.names[0]]))
    if PLANNER in own.get("base_local_planner", PLANNER):  # all drives counted so
        branch(made, PLANNER, create=True)["meter_scoring"] = False
    return made
