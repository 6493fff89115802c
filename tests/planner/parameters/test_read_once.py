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
PLUGINS = ("base_global_planner", "base_local_planner")
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
# Part of a path in MoveBase's state: who keeps the value of the start there
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
    elif isinstance(thing, (bool, int, float, str, np.generic, type(None))):
        values[path] = repr(thing)
    else:
        values[path] = ""  # a function, or another object without state
    # An object above itself would never end.
    if not values and id(thing) not in above:
        for name, part in parts:
            part_path = f"{path}.{name}"
            if part_path not in (".parameters", "._config") and name != "version":
                values.update(state(part, part_path, (*above, id(thing))))
    return values


def other(parameter, value):
    """Return another valid value of the parameter."""
    if parameter.type == "str":
        return FILED[parameter.name]
    if parameter.type == "bool":
        return not value
    moved = value + 1
    if parameter.type != "int":
        moved = 0.8 * value or 0.1
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
    # robot_radius counts only without a footprint.
    without_footprint = copy.deepcopy(plain)
    without_footprint["local_costmap"].pop("footprint")
    for server, (_, parameters) in MoveBase(plain).servers.items():
        for parameter in parameters:
            name = parameter.name
            if name == "restore_defaults" or name in PLUGINS:
                continue

            # Another value: once by a request, once from the files
            tree = without_footprint if name == "robot_radius" else plain
            reconfigured = MoveBase(tree)
            value = other(parameter, reconfigured.configuration(server)[name])
            loaded = MoveBase(with_value(tree, server, name, value))
            reconfigured.reconfigure(server, {name: value})
            assert reconfigured.configuration(server) == loaded.configuration(server), name

            # What differs has kept the value of the start.
            of_files = state(loaded)
            of_request = state(reconfigured)
            for path in {*of_files, *of_request}:
                if of_files.get(path) != of_request.get(path):
                    readers.setdefault((server, name), set()).add(reader_of(path))
            if is_declared_once(parameter, server, planner):
                declared[server, name] = set(parameter.once)
    assert readers == CPP[planner]
    assert declared == readers


def with_value(tree, server, name, value):
    """Return parameters with another value of a server, where C++ reads it."""
    changed = copy.deepcopy(tree)
    section = server if server in tree else server.rpartition("/")[0]
    branch(changed, section, create=True)[name] = value
    # C++ reads the parameter of a layer from the layer's own section.
    if "/" in server:
        branch(changed, server, create=True)[name] = value
        branch(changed, server.rpartition("/")[0]).pop(name, None)
    return changed


def reader_of(path):
    """Return who keeps a part of MoveBase's state, or the path if nobody should."""
    for part, reader in KEPT.items():
        if part in path:
            return reader
    return path


def is_declared_once(parameter, server, planner):
    """Return whether the tables say that a parameter is read only at start-up."""
    if server == "global_costmap" or not parameter.once:
        return False
    return server != "local_costmap" or planner in parameter.once


def test_only_the_outline_of_trajectoryplannerros_keeps_its_start_up_value():
    assert shapes_at_start("TrajectoryPlannerROS", "local_costmap", "footprint_padding")
    assert not shapes_at_start("DWAPlannerROS", "local_costmap", "footprint_padding")
    assert not shapes_at_start("TrajectoryPlannerROS", "global_costmap", "footprint_padding")
    assert not shapes_at_start("TrajectoryPlannerROS", "TrajectoryPlannerROS", "max_vel_theta")
