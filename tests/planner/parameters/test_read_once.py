"""Tests which reconfigurable parameters are read only at start-up: the same in C++, the tables and
MoveBase.

A value from a file and the same value from a later reconfigure must lead to the same state of
MoveBase, unless the parameter is read only at start-up.
"""

import copy

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.trees import branch
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import shapes_at_start
from applr_ros1.planner.parameters.parameter import GOAL, OUTLINE, PERIOD, RECOVERY

PLANNERS = {"jackal": "TrajectoryPlannerROS", "turtlebot3_waffle_pi": "DWAPlannerROS"}
FILED = {"footprint": "[[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]", "y_vels": "-0.2,0.2"}
# Parameters that name plugins, which MoveBase cannot change.
PLUGINS = (
    "base_global_planner",
    "base_local_planner",
)
# Code that reads parameters only once in C++: move_base.cpp:93 to 180 and loadRecoveryBehaviors,
# trajectory_planner_ros.cpp:103 to 270, rotate_recovery.cpp:60, dwa_planner_ros.cpp:92 with
# latched_stop_rotate_controller.h. DWAPlannerROS reads the footprint in every cycle.
BOTH = {
    ("", "controller_frequency"): {PERIOD},
    ("", "conservative_reset_dist"): {RECOVERY},
    ("", "clearing_rotation_allowed"): {RECOVERY},
}
CPP = {
    "DWAPlannerROS": BOTH,
    "TrajectoryPlannerROS": {
        **BOTH,
        ("TrajectoryPlannerROS", "acc_lim_x"): {GOAL},
        ("TrajectoryPlannerROS", "acc_lim_y"): {GOAL},
        ("TrajectoryPlannerROS", "acc_lim_theta"): {GOAL, RECOVERY},
        ("TrajectoryPlannerROS", "max_vel_theta"): {RECOVERY},
        ("TrajectoryPlannerROS", "min_in_place_vel_theta"): {GOAL, RECOVERY},
        ("local_costmap", "footprint"): {OUTLINE},
        ("local_costmap", "robot_radius"): {OUTLINE},
        ("local_costmap", "footprint_padding"): {OUTLINE},
    },
}
KEPT = {
    "recoveries": RECOVERY,
    "_footprint": OUTLINE,
    "acceleration": GOAL,
    "slowest_turn": GOAL,
    "local_planner": PERIOD,
}


def state(thing, path="", above=()):
    """Return the state of an object as {path: value}, without its parameter tree, configuration and
    counters.
    """
    values = {}
    if isinstance(thing, np.ndarray):
        values[path] = (thing.shape, thing.dtype.str, thing.tobytes())
    elif isinstance(thing, dict):
        parts = thing.items()
    elif isinstance(thing, (list, tuple)):
        parts = enumerate(thing)
    elif hasattr(thing, "__dict__"):
        parts = vars(thing).items()
    elif hasattr(type(thing), "__slots__"):
        parts = [(name, getattr(thing, name)) for name in type(thing).__slots__]
    else:
        values[path] = (
            repr(thing)
            if isinstance(thing, (bool, int, float, str, np.generic, type(None)))
            else ""
        )
    if not values and id(thing) not in above:
        for name, part in parts:
            here = f"{path}.{name}"
            if here not in (".parameters", "._config") and name != "version":
                values.update(state(part, here, (*above, id(thing))))
    return values


def other(parameter, value):
    """Return another valid value of the parameter."""
    if parameter.type in ("bool", "str"):
        return FILED[parameter.name] if parameter.type == "str" else not value
    moved = value + 1 if parameter.type == "int" else 0.8 * value or 0.1
    return moved if parameter.min <= moved <= parameter.max else value - 1


@pytest.mark.parametrize("name", PLANNERS)
def test_parameters_read_once_are_the_same_in_tables_move_base_and_cpp(name, monkeypatch):
    monkeypatch.setattr(np, "empty", np.zeros)  # Unwritten buffers would differ.
    monkeypatch.setattr(np, "empty_like", np.zeros_like)
    robot = robots.load(name)
    planner = PLANNERS[name]
    readers = {}
    declared = {}
    plain = robot.parameters()
    # The value of move_base itself then applies, as in most files.
    plain[planner].pop("controller_frequency", None)
    plain["global_costmap"].update(width=4, height=4)
    round_ = copy.deepcopy(plain)
    round_["local_costmap"].pop("footprint")
    for server, (_, parameters) in MoveBase(plain).servers.items():
        for p in parameters:
            if p.name == "restore_defaults" or p.name in PLUGINS:
                continue
            tree = round_ if p.name == "robot_radius" else plain
            reconfigured = MoveBase(tree)
            value = other(p, reconfigured.configuration(server)[p.name])
            given = copy.deepcopy(tree)
            place = server if server in plain else server.rpartition("/")[0]
            branch(given, place, create=True)[p.name] = value
            if "/" in server:  # C++ reads the parameter of a layer from the layer's own section.
                branch(given, server, create=True)[p.name] = value
                branch(given, server.rpartition("/")[0]).pop(p.name, None)
            loaded = MoveBase(given)
            reconfigured.reconfigure(server, {p.name: value})
            assert reconfigured.configuration(server) == loaded.configuration(server), (
                server,
                p.name,
            )
            one = state(loaded)
            two = state(reconfigured)
            differ = [path for path in {*one, *two} if one.get(path) != two.get(path)]
            for path in differ:
                reader = next((who for part, who in KEPT.items() if part in path), path)
                readers.setdefault((server, p.name), set()).add(reader)
            if (
                p.once
                and (server != "global_costmap")
                and (server != "local_costmap" or planner in p.once)
            ):
                declared[server, p.name] = set(p.once)
    assert readers == CPP[planner]
    assert declared == readers


def test_only_the_outline_of_trajectoryplannerros_keeps_its_start_up_value():
    there = "local_costmap", "footprint_padding"
    assert shapes_at_start("TrajectoryPlannerROS", *there)
    assert not shapes_at_start("DWAPlannerROS", *there)
    assert not shapes_at_start("TrajectoryPlannerROS", "global_costmap", "footprint_padding")
    assert not shapes_at_start("TrajectoryPlannerROS", "TrajectoryPlannerROS", "max_vel_theta")
