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
from applr_ros1.planner.parameters.move_base_parameters import DEFAULT_RECOVERIES
from applr_ros1.planner.parameters.parameter import ParameterError, by_name
from tests.support import ROOT
from tests.support.refusals import refused
from tests.support.robots import JACKAL_PARAMETERS

SURFACE, DWA_SURFACE, MAP_SURFACE = (
    json.loads((ROOT / "tests" / "data" / name).read_text())
    for name in ("move_base_surface.json", "dwa_surface.json", "turtlebot3_surface.json")
)
DWA = {
    "base_local_planner": "dwa_local_planner/DWAPlannerROS",
    "DWAPlannerROS": {"min_vel_y": 0, "max_vel_y": 0},
}
PLANNER = "TrajectoryPlannerROS"


TURN = "rotate_recovery/RotateRecovery"
CLEAR = "clear_costmap_recovery/ClearCostmapRecovery"
NOT_ZERO = [
    (server, p)
    for server in ("", PLANNER, "local_costmap")
    for p in SERVERS[server]
    if p.not_zero and p.min <= 0
]


def changed(path, value):
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    *folders, name = path.split("/")
    here = tree
    for folder in folders:
        here = here.setdefault(folder, {})
    here[name] = value
    return tree


def number(value):
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
    start_up = Configuration(complete(JACKAL_PARAMETERS)).start_up(server)
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
    for name, value in Configuration(complete(tree))["DWAPlannerROS"].items():
        assert value == cpp_values[name], name


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
    for tree, planner in itertools.product(({}, DWA), ("DWAPlannerROS", PLANNER)):
        assert (
            complete(dict(tree, controller_frequency=10.0))[planner]["controller_frequency"] == 10.0
        )
    own = complete({"controller_frequency": 10.0, "DWAPlannerROS": {"controller_frequency": 5.0}})
    assert own["DWAPlannerROS"]["controller_frequency"] == 5.0


@pytest.mark.parametrize("planner", ["DWAPlannerROS", PLANNER])
def test_a_control_rate_below_one_hertz_is_taken_as_in_cpp(planner):
    completed = complete({**DWA, planner: {"controller_frequency": 0.5}})
    assert completed[planner]["controller_frequency"] == 0.5


def test_files_without_sideways_speeds_get_a_warning_with_the_defaults_of_the_planner():
    (line,) = (line for line in remarks({**DWA, "DWAPlannerROS": {}}) if "sideways" in line)
    assert "(-0.1, 0.1)" in line


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
    refused(lambda: config.request("DWAPlannerROS", values), words, kind=ParameterError)


def test_jackal_is_clean_and_complete_is_stable_and_equals_the_running_tree():
    assert check(JACKAL_PARAMETERS) == []
    assert check({}) == []
    full = complete(JACKAL_PARAMETERS)
    assert complete(full) == full == complete(SURFACE["params"])
    assert check(full) == []
    assert full["aggressive_reset"]["reset_distance"] == 1.84


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (PLANNER + "/xy_goal_tolerance", -0.1, "is -0.1: give a value from 0.0 to inf"),
        (PLANNER + "/world_model", "freespace", "give costmap"),
        (PLANNER + "/sim_granularity", 1e-9, "is 1e-09: .*more than 100000 points"),
        ("rotate_recovery/sim_granularity", 1e-9, "100000 points"),
        ("controller_frequency", 0, "is 0: give a number above 0"),
        ("local_costmap/width", 100000, "cells"),
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
def test_check_reports_problem_value_and_remedy(path, value, words):
    name = path.rpartition("/")[2]
    lines = check(changed(path, value))
    assert any(re.search(words, line) and name in line for line in lines), lines
    assert all("\n" not in line for line in lines)


def test_values_are_read_as_roscpp_reads_them():
    tree = dict(
        JACKAL_PARAMETERS, footprint=[[0.27, 0.21], [0.27, -0.21], [-0.27, 0.0]], obstacle_range=2.0
    )
    local = tree["local_costmap"] = copy.deepcopy(JACKAL_PARAMETERS["local_costmap"])
    del local["footprint"], local["obstacles_layer"]["scan"]["obstacle_range"]
    local["obstacles_layer"].pop("obstacle_range", None), local.pop("obstacle_range", None)
    tree[PLANNER] = dict(JACKAL_PARAMETERS[PLANNER], vx_samples=6.5, vtheta_samples=20.4)
    tree["DWAPlannerROS"] = {"max_vel_x": "fast", "unread": 1}
    assert check(tree) == []
    assert remarks(tree) == []
    full = complete(tree)
    # 0.5 is rounded up.
    assert [full[PLANNER][name] for name in ("vx_samples", "vtheta_samples")] == [
        7,
        20,
    ]
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
        (
            "recovery_behaviors",
            [{"name": "turn", "type": "RotateRecovery"}],
            KEPT,
            "",
        ),  # type without its package
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
    local = tree["local_costmap"]
    local["plugins"][:0] = [
        {"name": "a", "type": "lab::SonarLayer"},
        {"name": "c", "type": "stvl/TemporalVoxelLayer"},
    ]
    local["c"] = {"observation_sources": "scan", "voxel_decay": 15.0}
    local["plugins"].append({"name": "b", "type": "costmap_2d::VoxelLayer"})
    local["b"] = {
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
    tree = {
        name: {"plugins": plugins, "static_map": {"first_map_only": True}}
        for name in ("global_costmap",)
    }
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
    layer["observation_sources"], layer["laser"] = "laser", layer.pop("scan")
    layer["laser"]["raytrace_range"] = 4.5
    assert check(tree) == []
    assert complete(tree)["local_costmap"]["obstacles_layer"]["laser"]["raytrace_range"] == 4.5
    layer["observation_sources"] = "laser bump"
    assert check(tree) == []
    # Defaults of C++, and the layer's ranges.
    bump = complete(tree)["local_costmap"]["obstacles_layer"]["bump"]
    assert (bump["topic"], bump["data_type"], bump["clearing"]) == ("bump", "PointCloud", False)
    assert (bump["obstacle_range"], bump["min_obstacle_height"]) == (2.5, 0.0)
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
    assert (
        full["inflater_layer"]["inflation_radius"],
        full["obstacles_layer"]["raytrace_range"],
    ) == (0.7, 5.0)
    # A value of the source itself takes precedence.
    assert full["obstacles_layer"]["scan"]["raytrace_range"] == 3.0


def test_a_value_clamped_to_an_invalid_zero_is_rejected():
    config = Configuration(complete(JACKAL_PARAMETERS))
    assert len(NOT_ZERO) > 5
    for server, parameter in NOT_ZERO:
        for value in (0, -1):
            with pytest.raises(
                ParameterError, match="%s is .*: give a number above 0" % parameter.name
            ):
                config.request(server, {parameter.name: value})
        (line,) = check(changed(server + "/" + parameter.name if server else parameter.name, -1))
        assert "give a number above 0" in line, parameter.name


def test_a_costmap_without_cells_is_rejected_before_anything_changes():
    move_base = MoveBase(JACKAL_PARAMETERS)
    name = "global_costmap"
    before = dict(move_base.configuration(name))
    size = move_base.global_costmap.size
    with pytest.raises(ParameterError, match="%s/width, height are .* no cells" % name):
        move_base.reconfigure(name, {"width": 1, "resolution": 1.5})
    assert (dict(move_base.configuration(name)), move_base.global_costmap.size) == (before, size)
    assert (
        move_base.reconfigure(name, {"width": 1, "height": 1, "resolution": 1.0})["resolution"]
        == 1.0
    )


def test_a_costmap_with_a_static_map_starts_with_its_usual_values():
    plugins = [{"name": "world", "type": "costmap_2d::StaticLayer"}]
    tree = {"global_costmap": {"plugins": plugins}, "local_costmap": {"plugins": plugins}}
    assert check(tree) == []
    assert MoveBase(tree).global_costmap.size == (200, 200)


def test_a_request_for_endless_trajectories_is_rejected():
    config = Configuration(complete(JACKAL_PARAMETERS))
    name = "angular_sim_granularity"
    with pytest.raises(ParameterError, match="%s is 1e-09.*more than 100000 points" % name):
        config.request(PLANNER, {name: 1e-9})
    slow = {"max_vel_x": 0.0, "min_vel_x": 0.0, "escape_vel": 0.0, "sim_granularity": 1e-9}
    config.request(PLANNER, slow)
    refused(
        lambda: config.request(PLANNER, dict(slow, heading_scoring=True)),
        "heading_scoring",
        kind=ParameterError,
    )


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
    assert (
        full["conservative_reset"]["layer_names"]
        == full["wide"]["layer_names"]
        == ["obstacles_layer"]
    )
    assert complete(full) == full


class TestConfiguration:
    @pytest.fixture
    def config(self):
        return Configuration(complete(JACKAL_PARAMETERS))

    def test_clamps_and_keeps_the_rest(self, config):
        new = config.request(PLANNER, {"max_vel_x": 1e9, "vx_samples": -5})
        assert (new["max_vel_x"], new["vx_samples"], new["sim_time"]) == (20.0, 1, 2.0)
        # A request changes nothing before it is accepted.
        assert config[PLANNER]["max_vel_x"] == 0.5

    def test_rejects_the_whole_request(self, config):
        for bad in (math.nan, math.inf, None, "1", True):
            with pytest.raises(ParameterError, match="max_vel_x"):
                config.request(PLANNER, {"sim_time": 1.0, "max_vel_x": bad})

    def test_older_names_always_follow(self, config):
        for name, other in (
            ("pdist_scale", "path_distance_bias"),
            ("goal_distance_bias", "gdist_scale"),
        ):
            config.accept(PLANNER, config.request(PLANNER, {name: 0.33}))
            assert config[PLANNER][name] == config[PLANNER][other] == 0.33
        # rqt_reconfigure sends all values after one changes.
        everything = dict(config[PLANNER], pdist_scale=0.5)
        new = config.request(PLANNER, everything)
        assert new["path_distance_bias"] == new["pdist_scale"] == 0.5

    def test_restore_defaults_is_the_start_up_state(self, config):
        config.accept(PLANNER, config.request(PLANNER, {"max_vel_x": 1.5}))
        new = config.request(PLANNER, {"restore_defaults": True, "max_vel_x": 1.7})
        assert new == config.start_up(PLANNER)
        assert new["max_vel_x"] == 0.5
        assert new["restore_defaults"] is False

    def test_refuses_unknown_names(self, config):
        refused(
            lambda: config.request(PLANNER, {"warp": 9}), "no such parameter", kind=ParameterError
        )
        refused(lambda: config.request("nowhere", {}), "no server", kind=ParameterError)

    def test_another_planner_cannot_be_loaded(self, config):
        assert (
            config.request("", {"base_global_planner": "x/Y"})["base_global_planner"]
            == "navfn/NavfnROS"
        )


def test_cfg_files_are_generated_without_numpy(tmp_path):
    prefixes = [
        path
        for path in ("/usr", "/opt/ros/noetic")
        if os.path.isdir(path + "/share/dynamic_reconfigure")
    ]
    if not prefixes:
        pytest.skip("no dynamic_reconfigure here")
    cfg = ROOT / "applr_ros1" / "cfg" / "TrajectoryPlanner.cfg"
    there = str(tmp_path)
    (tmp_path / "numpy.py").write_text("raise ImportError('numpy is not there at build time')")
    done = subprocess.run(
        [sys.executable, cfg, prefixes[0] + "/share/dynamic_reconfigure", there, there, there],
        env=dict(os.environ, PYTHONPATH=there + ":" + os.environ.get("PYTHONPATH", "")),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    made = {}
    exec((tmp_path / "cfg" / "TrajectoryPlannerConfig.py").read_text(), made)
    assert (made["defaults"]["vx_samples"], made["max"]["pdist_scale"]) == (20, 5.0)
    assert made["min"]["min_vel_theta"] == -20.0
