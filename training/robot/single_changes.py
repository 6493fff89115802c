"""Changes of single parameters, for a robot that does not drive at all."""

from __future__ import annotations

from typing import Any, Dict, Iterator, Sequence, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from training.why.candidates import Candidate

# Changes that are tried if no drive tells more: (parameter of the robot's
# space, factor on its value), in the order of the attempts. The first ones free most robots.
FACTORS = (
    ("occdist_scale", 0.1),
    ("occdist_scale", 0.01),
    ("sim_time", 1.5),
    ("sim_time", 0.6),
    ("max_vel_x", 0.5),
    ("goal_distance_bias", 3.0),
    ("path_distance_bias", 0.3),
    ("vx_samples", 3.0),
)
GOAL_TOLERANCE = 0.2  # tolerance of the goal that is tried [m, rad]


def single_candidates(robot: Robot) -> Iterator[Candidate]:
    """Yield changes of a single parameter of the planner for a robot that does not drive at all.

    A parameter of the robot's space may stand in several places, which change together.
    """
    tree = robot.all_parameters()
    space = {parameter.name: parameter for parameter in robot.space}
    for parameter_name, factor in FACTORS:
        parameter = space.get(parameter_name)
        if parameter is None:
            continue
        places = []
        for target in parameter.sets:
            for alias in target.names:
                places.append((target.server, alias))
        server, name_at_server = places[0]
        in_force = branch(tree, server)[name_at_server]
        short_value = float(f"{factor * in_force:.2g}")
        new_value = min(max(short_value, parameter.low), parameter.high)
        yield from _single(tree, places, new_value)

    # The planner must know what the base can do, and a goal must be reachable.
    planner = robot.local_planner
    base = robot.base
    yield from _single(tree, [(planner, "acc_lim_x")], base.max_acceleration)
    yield from _single(tree, [(planner, "acc_lim_theta")], base.max_yaw_acceleration)
    yield from _single(tree, [(planner, "yaw_goal_tolerance")], GOAL_TOLERANCE)
    yield from _single(tree, [(planner, "xy_goal_tolerance")], GOAL_TOLERANCE)
    yield from _single(tree, [("", "planner_frequency")], 1.0)


def _single(
    tree: Dict[str, Any], places: Sequence[Tuple[str, str]], value: float
) -> Iterator[Candidate]:
    """Yield a value for a parameter in all its places (server, name), unless it is in force."""
    server, name = places[0]
    in_force = branch(tree, server)[name]
    # A number of samples stays whole.
    new_value = type(in_force)(value)
    if new_value == in_force:
        return
    changes = []
    for server, name in places:
        changes.append(Change(server, name, branch(tree, server)[name], new_value))
    yield Candidate(tuple(changes))
