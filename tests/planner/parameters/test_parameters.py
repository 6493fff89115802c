"""Tests of parameter tables, checks and requests. Expected values come from running C++ nodes
(*_surface.json).
"""

import copy
import itertools
import json
import math
import os
import re
import subprocess
import sys

import pytest

from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete, remarks
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import SERVERS, servers
from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.parameters.move_base_parameters import DEFAULT_RECOVERIES
from applr_ros1.planner.parameters.parameter import ParameterError, by_name
from tests.support import ROOT
from tests.support.refusals import refused
from tests.support.robots import JACKAL_PARAMETERS


def surface(name):
    """Return the names, types and values of a running C++ node."""
    return json.loads((ROOT / "tests" / "data" / f"{name}_surface.json").read_text())


SURFACE = surface("move_base")
DWA_SURFACE = surface("dwa")
MAP_SURFACE = surface("turtlebot3")
DWA = {
    "base_local_planner": "dwa_local_planner/DWAPlannerROS",
    "DWAPlannerROS": {"min_vel_y": 0, "max_vel_y": 0},
}
PLANNER = "TrajectoryPlannerROS"


TURN = "rotate_recovery/RotateRecovery"
CLEAR = "clear_costmap_recovery/ClearCostmapRecovery"


def changed(path, value):
    """Return the Jackal's parameters with another value at a path ("local_costmap/width")."""
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    *folders, name = path.split("/")
    section = tree
    for folder in folders:
        section = section.setdefault(folder, {})
    section[name] = value
    return tree


def number(value):
    """Return a bound of a JSON file, which has no infinity."""
    return float(value) if value in ("inf", "-inf") else value


def assert_declared_as_in_cpp(parameter, cpp_parameter):
    """Assert that a declaration equals that of a C++ server, of which `cpp_parameter` is a dump."""
    assert parameter.name == cpp_parameter["name"]
    assert parameter.type == cpp_parameter["type"]
    assert parameter.min == number(cpp_parameter["min"])
    assert parameter.max == number(cpp_parameter["max"])
    assert parameter.default == cpp_parameter["default"]


@pytest.mark.parametrize("server", servers(complete(JACKAL_PARAMETERS)))
def test_servers_equal_the_cpp_ones(server):
    cpp_server = SURFACE["dynamic_reconfigure"][f"/move_base/{server}".rstrip("/")]
    start_up = Configuration(complete(JACKAL_PARAMETERS)).start_up[server]
    parameters = servers(complete(JACKAL_PARAMETERS))[server].parameters
    assert len(parameters) == len(cpp_server)
    for parameter, cpp_parameter in zip(parameters, cpp_server):
        assert_declared_as_in_cpp(parameter, cpp_parameter)
        assert start_up[parameter.name] == cpp_parameter["jackal"]


def test_the_dwa_planners_server_equals_the_cpp_one():
    cpp_server = DWA_SURFACE["dynamic_reconfigure"]["/move_base/DWAPlannerROS"]
    declared = by_name(SERVERS["DWAPlannerROS"])
    for cpp_parameter in cpp_server:
        assert_declared_as_in_cpp(declared[cpp_parameter["name"]], cpp_parameter)
    # This server has parameters of its own besides. The others come in the order of C++.
    cpp_names = [cpp_parameter["name"] for cpp_parameter in cpp_server]
    assert [name for name in declared if name in cpp_names] == cpp_names


def test_a_turtlebots_parameters_are_taken_as_cpp_takes_them():
    cpp_values = DWA_SURFACE["params"]["DWAPlannerROS"]
    # The robot's file has 0.
    tree = dict(DWA, DWAPlannerROS=dict(cpp_values, vy_samples=0))
    assert check(tree) == []
    values = Configuration(complete(tree))["DWAPlannerROS"]
    # C++ reads others once, and this server may have parameters of its own.
    for name in values.keys() & cpp_values.keys():
        assert values[name] == cpp_values[name], name


@pytest.mark.parametrize(
    ("tree", "used", "other"),
    [(JACKAL_PARAMETERS, PLANNER, "DWAPlannerROS"), (DWA, "DWAPlannerROS", PLANNER)],
)
def test_only_the_servers_of_the_planner_in_use_exist(tree, used, other):
    config = Configuration(complete(tree))
    assert config[used]["sim_time"] > 0
    with pytest.raises(ParameterError, match=f"no server '{other}'"):
        config[other]


def test_the_control_period_is_searched_upwards():
    """As searchParam does: from the planner's own namespace to that of move_base."""
    for tree, planner in itertools.product(({}, DWA), ("DWAPlannerROS", PLANNER)):
        completed = complete(dict(tree, controller_frequency=10.0))
        assert completed[planner]["controller_frequency"] == 10.0
    nearer = {"controller_frequency": 10.0, "DWAPlannerROS": {"controller_frequency": 5.0}}
    assert complete(nearer)["DWAPlannerROS"]["controller_frequency"] == 5.0


@pytest.mark.parametrize("planner", ["DWAPlannerROS", PLANNER])
def test_a_control_rate_below_one_hertz_is_taken_as_in_cpp(planner):
    completed = complete({**DWA, planner: {"controller_frequency": 0.5}})
    assert completed[planner]["controller_frequency"] == 0.5


def test_files_without_sideways_speeds_get_a_warning_with_the_defaults_of_the_planner():
    lines = [line for line in remarks({**DWA, "DWAPlannerROS": {}}) if "sideways" in line]
    assert len(lines) == 1
    assert "(-0.1, 0.1)" in lines[0]


SEEN = "local_costmap/obstacles_layer/"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"vx_samples": 2147483647}, "at most 1000000 together"),
        ({"sim_granularity": 1e-9}, "more than 100000 points"),
    ],
)
def test_dwa_values_that_cannot_be_run_give_one_line(values, words):
    (line,) = check(dict(DWA, DWAPlannerROS=dict(DWA["DWAPlannerROS"], **values)))
    assert words in line
    config = Configuration(complete(DWA))
    refused(lambda: config.result_of("DWAPlannerROS", values), words, kind=ParameterError)


@pytest.mark.parametrize(
    ("counts", "are_taken"),
    [
        # Each axis may have one sample more, at zero: 100 * 100 * 100
        ((99, 99, 99), True),
        ((99, 99, 100), False),
        # An axis has two samples at least: 3 * 3 * 111,111 are 999,999.
        ((1, 1, 111_110), True),
        ((1, 1, 111_111), False),
    ],
)
def test_a_cycle_of_dwa_has_a_million_samples_at_most(counts, are_taken):
    numbers_of_samples = dict(zip(SAMPLES, counts))
    tree = dict(DWA, DWAPlannerROS=dict(DWA["DWAPlannerROS"], **numbers_of_samples))
    assert (check(tree) == []) is are_taken


def test_jackal_is_clean_and_complete_is_stable_and_equals_the_running_tree():
    assert check(JACKAL_PARAMETERS) == []
    assert check({}) == []
    full = complete(JACKAL_PARAMETERS)
    assert complete(full) == full == complete(SURFACE["params"])
    assert check(full) == []
    assert full["aggressive_reset"]["reset_distance"] == 1.84


@pytest.mark.parametrize(
    ("path", "value", "pattern"),
    [
        (PLANNER + "/xy_goal_tolerance", -0.1, "is -0.1: give a value from 0.0 to inf"),
        (PLANNER + "/world_model", "freespace", "give costmap"),
        (PLANNER + "/sim_granularity", 1e-9, "is 1e-09: .*more than 100000 points"),
        ("rotate_recovery/sim_granularity", 1e-9, "100000 points"),
        ("controller_frequency", 0, "is 0: give a number above 0"),
        ("local_costmap/width", 100000, "cells"),
        # in millimetres
        (
            "local_costmap/footprint",
            "[[210, 165], [-210, 165], [-210, -165], [210, -165]]",
            "give at least three points, .* in metres",
        ),
        (
            "local_costmap/resolution",
            20.0,
            "local_costmap/width, height are 10 x 10 m.*20 m.*no cells",
        ),
        ("local_costmap/plugins", [{"name": "v"}], "give a name and a type of"),
        (SEEN + "scan/data_type", "Range", "LaserScan or PointCloud2"),
        (
            "recovery_behaviors",
            [{"name": "local_costmap", "type": CLEAR}],
            "'local_costmap'.*another",
        ),
    ],
)
def test_check_reports_problem_value_and_remedy(path, value, pattern):
    name = path.rpartition("/")[2]
    lines = check(changed(path, value))
    assert any(re.search(pattern, line) and name in line for line in lines), lines
    assert all("\n" not in line for line in lines)


def test_values_are_read_as_roscpp_reads_them():
    # Given: values that stand above the costmap alone, and numbers of samples that are not whole
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    tree["footprint"] = [[0.27, 0.21], [0.27, -0.21], [-0.27, 0.0]]
    tree["obstacle_range"] = 2.0
    local_costmap = tree["local_costmap"]
    del local_costmap["footprint"]
    layer = local_costmap["obstacles_layer"]
    for section in (local_costmap, layer, layer["scan"]):
        section.pop("obstacle_range", None)
    tree[PLANNER].update(vx_samples=6.5, vtheta_samples=20.4)
    # The section of a planner that is not in use is not read.
    tree["DWAPlannerROS"] = {"max_vel_x": "fast", "unread": 1}

    # Then: all are taken without a word
    assert check(tree) == []
    assert remarks(tree) == []
    full = complete(tree)
    # 0.5 is rounded up.
    assert full[PLANNER]["vx_samples"] == 7
    assert full[PLANNER]["vtheta_samples"] == 20
    # A list in the enclosing namespace is converted to text.
    assert full["local_costmap"]["footprint"] == "[[0.27, 0.21], [0.27, -0.21], [-0.27, 0.0]]"
    assert full["local_costmap"]["obstacles_layer"]["scan"]["obstacle_range"] == 2.0


MOVE_SLOW = {"name": "slow", "type": "move_slow_and_clear/MoveSlowAndClear"}
KEPT = [{"name": "turn", "type": TURN}]


@pytest.mark.parametrize(
    ("path", "value", "used", "warning"),
    [
        (
            PLANNER + "/vx_samples",
            "6",
            20,
            "is '6': the default 20 is used, as in C++; give a whole number",
        ),
        (PLANNER + "/max_vel_x", "1e-1", 0.55, "is '1e-1': the default 0.55 is used"),
        (PLANNER + "/max_vel_x", True, 0.55, "is True: the default 0.55 is used"),
        (
            PLANNER + "/dwa",
            1,
            False,
            "is 1: the default False is used, as in C++; give true or false",
        ),
        ("local_costmap/rolling_window", "true", False, "is 'true': the default False is used"),
        (SEEN + "scan/obstacle_range", "1.0", 2.5, "is '1.0': the default 2.5 is used"),
        (
            SEEN + "observation_sources",
            ["scan"],
            "",
            "is ['scan']: the default '' is used, as in C++; give text",
        ),
        (
            "recovery_behaviors",
            "none",
            DEFAULT_RECOVERIES,
            "has 'none': the default behaviours are used, as in C++",
        ),
        (
            "recovery_behaviors",
            [MOVE_SLOW, *KEPT],
            KEPT,
            "has move_slow_and_clear/MoveSlowAndClear: this type is not",
        ),
        # type without its package
        ("recovery_behaviors", [{"name": "turn", "type": "RotateRecovery"}], KEPT, ""),
        ("controller_frequency", "10", 20.0, "is '10': the default 20.0 is used"),
        (
            "local_costmap/robot_base_frame",
            "base",
            "base",
            "both costmaps use base_link of global_costmap",
        ),
    ],
)
def test_values_that_roscpp_ignores_get_the_default_and_a_warning(path, value, used, warning):
    tree = changed(path, value)
    assert check(tree) == []
    full = complete(tree)
    for part in path.split("/"):
        full = full[part]
    assert full == used
    lines = [line for line in remarks(tree) if line.startswith(path)]
    if warning:
        (line,) = lines
        assert warning in line
    else:
        assert lines == []


OLDER = {"min_in_place_rotational_vel": 0.7, "max_rotational_vel": 0.9, "acc_lim_th": 1.1}


@pytest.mark.parametrize(
    ("tree", "slowest", "fastest", "acceleration", "tolerance"),
    [({}, 0.4, 1.0, 3.2, 0.05), (DWA, 0.7, 0.9, 1.1, 0.1)],
    ids=["TrajectoryPlannerROS", "another planner"],
)
def test_rotate_recovery_reads_older_names_beside_another_local_planner(
    tree, slowest, fastest, acceleration, tolerance
):
    move_base = MoveBase(dict(tree, TrajectoryPlannerROS=OLDER))
    behaviours = {behaviour.name: behaviour for behaviour in move_base.recoveries}
    rotation = behaviours["rotate_recovery"]
    assert rotation.slowest_turn == slowest
    assert rotation.fastest_turn == fastest
    assert rotation.acceleration == acceleration
    assert rotation.tolerance == tolerance


def test_the_planner_reads_an_older_name_only_to_turn_to_the_goals_heading():
    """trajectory_planner_ros.cpp:219."""
    local_planner = MoveBase({PLANNER: OLDER}).local_planner
    assert local_planner.slowest_turn == 0.7
    assert local_planner.planner.in_force["min_in_place_vel_theta"] == 0.4  # rollouts
    with_newer_name = dict(OLDER, min_in_place_vel_theta=0.5)
    assert MoveBase({PLANNER: with_newer_name}).local_planner.slowest_turn == 0.5


def test_values_out_of_bounds_are_clamped_as_in_cpp():
    tree = changed(PLANNER + "/max_vel_x", 30)
    tree[PLANNER].update(min_vel_x=-0.2, acc_lim_th=1.0)
    tree["local_costmap"].update(update_frequency=200)
    assert check(tree) == []
    values = Configuration(complete(tree))[PLANNER]
    assert values["max_vel_x"] == 20.0
    assert values["min_vel_x"] == 0.0
    assert complete(tree)["local_costmap"]["update_frequency"] == 100.0
    lines = {}
    for line in remarks(tree):
        path, _, _ = line.partition(" ")
        lines[path.rpartition("/")[2]] = line
    assert set(lines) == {"max_vel_x", "min_vel_x", "acc_lim_th", "update_frequency"}
    clamped = "max_vel_x is 30.0: 20.0 is used, give a value from 0.0 to 20.0"
    assert lines["max_vel_x"] == f"{PLANNER}/{clamped}"
    assert lines["acc_lim_th"].endswith("is ignored: give acc_lim_theta")


def test_unavailable_layer_types_are_reported_and_the_other_layers_used():
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    local_costmap = tree["local_costmap"]
    # Layers of packages that are not here. Of the second, the sources tell that it marks
    # obstacles.
    local_costmap["plugins"][:0] = [
        {"name": "a", "type": "lab::SonarLayer"},
        {"name": "c", "type": "stvl/TemporalVoxelLayer"},
    ]
    local_costmap["c"] = {"observation_sources": "scan", "voxel_decay": 15.0}
    local_costmap["plugins"].append({"name": "b", "type": "costmap_2d::VoxelLayer"})
    local_costmap["b"] = {
        "z_voxels": 8,
        "observation_sources": "scan",
        "scan": {"topic": "low", "data_type": "LaserScan"},
    }
    tree["global_costmap"] = {"map_type": "voxel", "robot_base_frame": "base_link"}
    assert check(tree) == []
    missing = "this layer type is not available"
    replaced = f"{missing}, an obstacle layer replaces it"
    assert [line for line in remarks(tree) if "ignored" not in line] == [
        "global_costmap/map_type is voxel: an obstacle layer replaces the voxel layer",
        f"local_costmap/plugins has lab::SonarLayer: {missing}, it is left out",
        f"local_costmap/plugins has stvl/TemporalVoxelLayer: {replaced}",
        f"local_costmap/plugins has costmap_2d::VoxelLayer: {replaced}",
    ]
    full = complete(tree)
    assert "local_costmap/a" not in servers(full)
    assert "local_costmap/c" in servers(full)
    assert full["local_costmap"]["b"]["scan"]["topic"] == "low"
    assert "obstacle_layer" in full["global_costmap"]


def test_a_layer_may_have_the_name_of_a_parameter_without_plugins():
    plugins = [{"name": "static_map", "type": "costmap_2d::StaticLayer"}]
    tree = {"global_costmap": {"plugins": plugins, "static_map": {"first_map_only": True}}}
    assert check(tree) == []
    assert complete(tree)["global_costmap"]["static_map"]["first_map_only"] is True
    tree["global_costmap"]["plugins"] = []  # A section instead of a flag is ignored.
    assert complete(tree)["global_costmap"]["static_map"] is False


def test_an_invalid_tree_is_not_completed():
    with pytest.raises(ParameterError, match="give a name and a type"):
        complete(changed("local_costmap/plugins", [{"type": "costmap_2d::StaticLayer"}]))


def test_scan_source_may_have_any_name():
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    layer = tree["local_costmap"]["obstacles_layer"]
    layer["observation_sources"] = "laser"
    layer["laser"] = layer.pop("scan")
    layer["laser"]["raytrace_range"] = 4.5
    assert check(tree) == []
    assert complete(tree)["local_costmap"]["obstacles_layer"]["laser"]["raytrace_range"] == 4.5
    layer["observation_sources"] = "laser bump"
    assert check(tree) == []
    # A source without a section of its own has the defaults of C++.
    bump = complete(tree)["local_costmap"]["obstacles_layer"]["bump"]
    assert (bump["topic"], bump["data_type"], bump["clearing"]) == ("bump", "PointCloud", False)
    assert bump["obstacle_range"] == 2.5
    assert bump["min_obstacle_height"] == 0.0
    layer["bump"] = "no section"
    assert complete(tree)["local_costmap"]["obstacles_layer"]["bump"] == bump


TURTLEBOT = {  # costmap parameters as in turtlebot3_navigation
    "global_frame": "map",
    "static_map": True,
    "obstacle_range": 3.0,
    "raytrace_range": 3.5,
    "inflation_radius": 1.0,
    "cost_scaling_factor": 3.0,
    "map_type": "costmap",
    "observation_sources": "scan",
    "scan": {
        "sensor_frame": "base_scan",
        "data_type": "LaserScan",
        "topic": "scan",
        "clearing": True,
    },
}


def test_files_without_plugins_get_the_layers_that_cpp_gives_them():
    tree = {
        "global_costmap": TURTLEBOT,
        "local_costmap": dict(TURTLEBOT, static_map=False, track_unknown_space=True),
    }
    assert check(tree) == []
    full = complete(tree)
    global_costmap = full["global_costmap"]
    local_costmap = full["local_costmap"]
    layer_names = [layer["name"] for layer in global_costmap["plugins"]]
    assert layer_names == ["static_layer", "obstacle_layer", "inflation_layer"]
    layer_names = [layer["name"] for layer in local_costmap["plugins"]]
    assert layer_names == ["obstacle_layer", "inflation_layer"]

    # Layers get the values that stand at their costmap.
    cpp_layers = MAP_SURFACE["params"]["global_costmap"]
    assert cpp_layers["obstacle_layer"]["obstacle_range"] == 3.0
    assert global_costmap["obstacle_layer"]["scan"]["obstacle_range"] == 3.0
    assert global_costmap["inflation_layer"] == cpp_layers["inflation_layer"]
    assert "inflation_radius" not in global_costmap
    assert local_costmap["track_unknown_space"] is True
    assert local_costmap["obstacle_layer"]["track_unknown_space"] is True
    assert complete(full) == full
    assert check(full) == []
    names = {name for name in servers(full) if "costmap" in name}
    assert names == {name[11:] for name in MAP_SURFACE["dynamic_reconfigure"] if "costmap" in name}


def test_values_at_the_costmap_replace_those_of_the_layers():
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    tree["local_costmap"].update(inflation_radius=0.7, raytrace_range=5.0)
    full = complete(tree)["local_costmap"]
    assert full["inflater_layer"]["inflation_radius"] == 0.7
    assert full["obstacles_layer"]["raytrace_range"] == 5.0
    # A value of the source itself takes precedence.
    assert full["obstacles_layer"]["scan"]["raytrace_range"] == 3.0


def test_a_value_clamped_to_an_invalid_zero_is_rejected():
    config = Configuration(complete(JACKAL_PARAMETERS))
    checked = 0
    for server in ("", PLANNER, "local_costmap"):
        for parameter in SERVERS[server]:
            # Only bounds of 0 or less clamp to a zero.
            if not parameter.not_zero or parameter.min > 0:
                continue
            name = parameter.name
            for value in (0, -1):
                with pytest.raises(ParameterError, match=f"{name} is .*: give a number above 0"):
                    config.result_of(server, {name: value})
            (line,) = check(changed(f"{server}/{name}" if server else name, -1))
            assert "give a number above 0" in line, name
            checked += 1
    assert checked > 5


def test_a_costmap_without_cells_is_rejected_before_anything_changes():
    move_base = MoveBase(JACKAL_PARAMETERS)
    name = "global_costmap"
    earlier = dict(move_base.configuration(name))
    size = move_base.global_costmap.size
    with pytest.raises(ParameterError, match="%s/width, height are .* no cells" % name):
        move_base.reconfigure(name, {"width": 1, "resolution": 1.5})
    assert dict(move_base.configuration(name)) == earlier
    assert move_base.global_costmap.size == size
    one_cell = {"width": 1, "height": 1, "resolution": 1.0}
    assert move_base.reconfigure(name, one_cell)["resolution"] == 1.0


def test_a_costmap_with_a_static_map_starts_with_its_usual_values():
    plugins = [{"name": "world", "type": "costmap_2d::StaticLayer"}]
    tree = {"global_costmap": {"plugins": plugins}, "local_costmap": {"plugins": plugins}}
    assert check(tree) == []
    assert MoveBase(tree).global_costmap.size == (200, 200)


def test_a_request_for_endless_trajectories_is_rejected():
    config = Configuration(complete(JACKAL_PARAMETERS))
    name = "angular_sim_granularity"
    with pytest.raises(ParameterError, match="%s is 1e-09.*more than 100000 points" % name):
        config.result_of(PLANNER, {name: 1e-9})
    slow = {"max_vel_x": 0.0, "min_vel_x": 0.0, "escape_vel": 0.0, "sim_granularity": 1e-9}
    config.result_of(PLANNER, slow)
    scoring = dict(slow, heading_scoring=True)
    refused(lambda: config.result_of(PLANNER, scoring), "heading_scoring", kind=ParameterError)


# Parameters of clear_costmap_recovery that later versions of C++ have
CLEARING = {"layer_names": ["obstacles_layer"], "affected_maps": "both", "force_updating": True}


def test_recovery_parameters_of_cpp_files_are_taken():
    tree = dict(
        JACKAL_PARAMETERS,
        conservative_reset=dict(CLEARING, reset_distance=3.0),
        aggressive_reset=dict(CLEARING, invert_area_to_clear=False),
        rotate_recovery={"frequency": 10.0},
        recovery_behaviors=[{"name": "wide", "type": CLEAR}, {"name": "turn", "type": TURN}],
        wide=dict(CLEARING, reset_distance=7.0),
        turn={"frequency": 5.0, "sim_granularity": 0.02},
    )
    assert check(tree) == []
    assert remarks(tree) == []
    full = complete(tree)
    assert full["conservative_reset"]["layer_names"] == ["obstacles_layer"]
    assert full["wide"]["layer_names"] == ["obstacles_layer"]
    assert complete(full) == full


class TestConfiguration:
    @pytest.fixture
    def config(self):
        """Return the Jackal's configuration at its start."""
        return Configuration(complete(JACKAL_PARAMETERS))

    def test_clamps_and_keeps_the_rest(self, config):
        accepted = config.result_of(PLANNER, {"max_vel_x": 1e9, "vx_samples": -5})
        assert (accepted["max_vel_x"], accepted["vx_samples"], accepted["sim_time"]) == (
            20.0,
            1,
            2.0,
        )
        # A request changes nothing before it is accepted.
        assert config[PLANNER]["max_vel_x"] == 0.5

    def test_rejects_the_whole_request(self, config):
        for invalid in (math.nan, math.inf, None, "1", True):
            with pytest.raises(ParameterError, match="max_vel_x"):
                config.result_of(PLANNER, {"sim_time": 1.0, "max_vel_x": invalid})

    def test_older_names_always_follow(self, config):
        for name, older in (
            ("pdist_scale", "path_distance_bias"),
            ("goal_distance_bias", "gdist_scale"),
        ):
            config.accept(PLANNER, config.result_of(PLANNER, {name: 0.33}))
            assert config[PLANNER][name] == config[PLANNER][older] == 0.33
        both = config.result_of(PLANNER, {"pdist_scale": 0.5, "path_distance_bias": 0.25})
        assert both["path_distance_bias"] == both["pdist_scale"] == 0.25, "the newer name wins"
        # rqt_reconfigure sends all values after one changes.
        everything = dict(config[PLANNER], pdist_scale=0.5)
        accepted = config.result_of(PLANNER, everything)
        assert accepted["path_distance_bias"] == accepted["pdist_scale"] == 0.5

    def test_restore_defaults_is_the_start_up_state(self, config):
        config.accept(PLANNER, config.result_of(PLANNER, {"max_vel_x": 1.5}))
        accepted = config.result_of(PLANNER, {"restore_defaults": True, "max_vel_x": 1.7})
        assert accepted == config.start_up[PLANNER]
        assert accepted["max_vel_x"] == 0.5
        assert accepted["restore_defaults"] is False

    def test_refuses_unknown_names(self, config):
        refused(
            lambda: config.result_of(PLANNER, {"warp": 9}),
            "no such parameter",
            kind=ParameterError,
        )
        refused(lambda: config.result_of("nowhere", {}), "no server", kind=ParameterError)

    def test_another_planner_cannot_be_loaded(self, config):
        accepted = config.result_of("", {"base_global_planner": "x/Y"})
        assert accepted["base_global_planner"] == "navfn/NavfnROS"


def test_cfg_files_are_generated_without_numpy(tmp_path):
    shares = [f"{prefix}/share/dynamic_reconfigure" for prefix in ("/usr", "/opt/ros/noetic")]
    shares = [share for share in shares if os.path.isdir(share)]
    if not shares:
        pytest.skip("no dynamic_reconfigure here")
    cfg = ROOT / "applr_ros1" / "cfg" / "TrajectoryPlanner.cfg"
    folder = str(tmp_path)
    (tmp_path / "numpy.py").write_text("raise ImportError('numpy is not there at build time')")

    # As catkin runs the file: with folders for C++, documentation and Python
    generated = subprocess.run(
        [sys.executable, cfg, shares[0], folder, folder, folder],
        env=dict(os.environ, PYTHONPATH=folder + ":" + os.environ.get("PYTHONPATH", "")),
        capture_output=True,
        text=True,
    )
    assert generated.returncode == 0, generated.stderr
    module = {}
    exec((tmp_path / "cfg" / "TrajectoryPlannerConfig.py").read_text(), module)
    assert module["defaults"]["vx_samples"] == 20
    assert module["max"]["pdist_scale"] == 5.0
    assert module["min"]["min_vel_theta"] == -20.0
