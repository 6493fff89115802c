"""Start-up parameters of move_base from a parameter set.

They are like those in a YAML file loaded after the robot's own files. A parameter set may act
differently when loaded at start-up than when applied by reconfigure (shapes_at_start in
planner/parameters/declarations). Because tuned.yaml is loaded, `./applr tune` drives with loaded
parameter sets. The method `static` applies its parameter set to a running move_base.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, Mapping, Optional, Tuple

from applr_ros1.planner.parameters.declarations import shapes_at_start
from applr_ros1.planner.parameters.layers import section_in_files
from applr_ros1.planner.parameters.obstacle_range import seeing
from applr_ros1.planner.parameters.trees import branch, merged
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY


def move_base_parameters(
    robot: Robot, values: Mapping[str, Any], obstacle_range: Optional[float] = None
) -> Dict[str, Any]:
    """Return a parameter set as nested parameters of move_base, for after the robot's own files.

    Names and places follow the robot's files, which may use older names (robots.robot.number_at).
    Parameters that act differently when loaded than by reconfigure are left out (loadable_space).

    Args:
        robot: Robot whose files are loaded first.
        values: Parameter set {name: value}, which may leave out parameters.
        obstacle_range: Range [m] up to which lasers mark obstacles, None for that of the files.
    """
    start_up: Dict[str, Any] = {}
    tree = robot.parameters()
    if obstacle_range is not None:
        # The file may be loaded with a map, and without one.
        for setup in robot.move_base:
            if setup is not None:
                start_up = merged(start_up, seeing(setup, obstacle_range))
    space = loadable_space(robot)
    numbers = space.as_dict(space.from_dict(dict(values)))
    for index, target in space.chosen.addresses:
        parameter_name = space.chosen.names[index]
        if parameter_name not in values:
            continue
        section_path = section_in_files(tree, target.server)
        # Under each name that the files use, so that none of them keeps the old value.
        recorded = branch(tree, section_path)
        recorded_names = [alias for alias in target.names if alias in recorded]
        if not recorded_names:
            recorded_names = [target.name]
        loaded_value = target.signed(numbers[parameter_name])
        section = branch(start_up, section_path, create=True)
        section.update(dict.fromkeys(recorded_names, loaded_value))
    if TRAJECTORY in tree.get("base_local_planner", TRAJECTORY):
        # Searches drive with biases per costmap cell.
        branch(start_up, TRAJECTORY, create=True)["meter_scoring"] = False
    return start_up


def loadable_space(robot: Robot) -> Space:
    """Return the robot's space with only the parameters that can be loaded as `chosen`.

    They act the same when loaded and when set by reconfigure.
    """
    space = space_of(robot)
    fixed_names: Tuple[str, ...] = ()
    for parameter_name, targets in space.targets.items():
        for target in targets:
            if shapes_at_start(robot.local_planner, target.server, target.name):
                fixed_names = (*fixed_names, parameter_name)
    return replace(space, fixed=fixed_names)
