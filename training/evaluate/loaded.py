"""Start-up parameters of move_base from a parameter set, as in a YAML file loaded after the robot's own files.

A parameter set may act differently when loaded at start-up than when applied by reconfigure (shapes_at_start in
planner/parameters/declarations). Because tuned.yaml is loaded, `./applr tune` drives with loaded parameter sets. The
method `static` applies its parameter set to a running move_base.
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
    """Return a parameter set as nested parameters of move_base, to be loaded after the robot's own files.

    Names and places follow the robot's files, which may use older names (robots.robot.number_at). Parameters that act
    differently when loaded than by reconfigure are left out (loadable_space).

    Args:
        robot: Robot whose files are loaded first.
        values: Parameter set {name: value}, which may leave out parameters.
    """
    made: Dict[str, Any] = {}
    tree, space = robot.parameters(), loadable_space(robot)
    numbers = space.as_dict(space.from_dict(dict(values)))
    for i, target in space.chosen.addresses:
        name = space.chosen.names[i]
        if name in values:
            costmap = target.server.rpartition("/")[0]
            place = costmap if costmap and "plugins" not in branch(tree, costmap) else target.server
            names = [each for each in target.names if each in branch(tree, place)] or [target.name]
            branch(made, place, create=True).update(
                dict.fromkeys(names, target.signed(numbers[name]))
            )
    if TRAJECTORY in tree.get(
        "base_local_planner", TRAJECTORY
    ):  # searches drive with biases per costmap cell
        branch(made, TRAJECTORY, create=True)["meter_scoring"] = False
    return made


def loadable_space(robot: Robot) -> Space:
    """Return the robot's space. Its `chosen` parameters act the same when loaded and when set by reconfigure."""
    planner, space = robot.local_planner, space_of(robot)
    at_start: Tuple[str, ...] = tuple(
        name
        for name, targets in space.targets.items()
        if any(
            shapes_at_start(planner, target.server, each)
            for target in targets
            for each in target.names
        )
    )
    return replace(space, fixed=at_start)
