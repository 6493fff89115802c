"""A parameter set as what move_base starts with: the parameters of a YAML that is loaded after the robot's own files.

By reconfigure a set may mean something else (planner/parameters/declarations.shapes_at_start). tuned.yaml is loaded, so
that `./applr tune` drives with it loaded; method `static` sets its set in a move_base that runs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, Mapping, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.declarations import shapes_at_start
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY


def move_base_parameters(robot: Robot, values: Mapping[str, Any]) -> Dict[str, Any]:
    """A set as the nested parameters of move_base that, loaded after the robot's own files, replace theirs.

    They have the names and places of those files, which may be older ones (robots.robot.number_at). What would mean
    something else there than by reconfigure is left out (loadable_space).

    Args:
        robot: The robot.
        values: {name: value} of the set; parameters that it leaves out stay out.
    """
    made: Dict[str, Any] = {}
    space, own, known = space_of(robot), robot.parameters(), loadable_space(robot).chosen.names
    for server, request in space.requests(space.from_dict(dict(values))).items():
        costmap = server.rpartition("/")[0]
        place = costmap if costmap and "plugins" not in branch(own, costmap) else server
        for i, target in space.targets_of(server):
            if space.names[i] not in values or space.names[i] not in known:
                continue
            names = [name for name in target.names if name in branch(own, place)] or target.names[:1]
            branch(made, place, create=True).update(dict.fromkeys(names, request[target.names[0]]))
    if TRAJECTORY in own.get("base_local_planner", TRAJECTORY):  # all drives counted so
        branch(made, TRAJECTORY, create=True)["meter_scoring"] = False
    return made


def with_set(robot: Robot, values: Mapping[str, Any]) -> Robot:
    """Return the robot whose own files are followed by a set {name: value}."""
    return robot.with_parameters(move_base_parameters(robot, values), robot.name)


def loadable_space(robot: Robot) -> Space:
    """Return the robot's space, of which `chosen` are those parameters that mean the same loaded and by reconfigure."""
    planner, space = robot.local_planner, space_of(robot)
    at_start: Tuple[str, ...] = tuple(
        name
        for name, targets in space.targets.items()
        if any(shapes_at_start(planner, target.server, each) for target in targets for each in target.names)
    )
    return replace(space, fixed=at_start)
