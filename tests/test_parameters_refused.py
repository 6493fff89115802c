"""Parameter trees and requests that no robot can run with: one line each, and what C++ files may hold is taken."""

import copy

import pytest

from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete, remark
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import JACKAL, SERVERS, ParameterError

PLANNER = "TrajectoryPlannerROS"
TURN, CLEAR = "rotate_recovery/RotateRecovery", "clear_costmap_recovery/ClearCostmapRecovery"
BARE = {name: {"observation_sources": "scan"} for name in ("global_costmap", "local_costmap")}
NOT_ZERO = [
    (server, p) for server in ("", PLANNER, "local_costmap") for p in SERVERS[server] if p.not_zero and p.min <= 0
]


def changed(path, value):
    tree = copy.deepcopy(JACKAL)
    *folders, name = path.split("/")
    here = tree
    for folder in folders:
        here = here.setdefault(folder, {})
    here[name] = value
    return tree


def one_line(tree, *words):
    (line,) = check(tree)
    assert "\n" not in line
    for word in words:
        assert word in line, line
    with pytest.raises(ParameterError):
        complete(tree)


@pytest.mark.parametrize(("server", "p"), NOT_ZERO, ids=[p.name for _, p in NOT_ZERO])
def test_what_would_be_clamped_to_a_useless_zero_is_refused_as_zero_is(server, p):
    config = Configuration(complete(JACKAL))
    for value in (0, -1):
        with pytest.raises(ParameterError, match="%s is .* cannot work" % p.name):
            config.request(server, {p.name: value})
    (line,) = check(changed(server + "/" + p.name if server else p.name, -1))
    assert "cannot work" in line


def test_a_negative_control_frequency_leaves_the_robot_as_it_is():
    move_base = MoveBase(JACKAL)
    before = dict(move_base.configuration(""))
    with pytest.raises(ParameterError, match="controller_frequency is -1"):
        move_base.reconfigure("", {"controller_frequency": -1})
    assert dict(move_base.configuration("")) == before


@pytest.mark.parametrize("name", ["local_costmap", "global_costmap"])
def test_a_costmap_without_cells_is_refused_before_anything_changes(name):
    move_base = MoveBase(JACKAL)
    before, size = dict(move_base.configuration(name)), move_base.costmaps[name].size
    for values in ({"resolution": 50.0}, {"width": 1, "resolution": 1.5}, {"height": 1, "resolution": 1.5}):
        with pytest.raises(ParameterError, match="%s/width, height are .* no cells" % name):
            move_base.reconfigure(name, values)
        assert dict(move_base.configuration(name)) == before
        assert move_base.costmaps[name].size == size
    assert move_base.reconfigure(name, {"width": 1, "height": 1, "resolution": 1.0})["resolution"] == 1.0


@pytest.mark.parametrize("rolling", [True, False])
def test_a_tree_without_cells_is_one_line(rolling):
    tree = changed("local_costmap/resolution", 20.0)
    tree["local_costmap"]["rolling_window"] = rolling
    one_line(tree, "local_costmap/width, height are 10 x 10 m", "20 m", "no cells")


def test_a_costmap_with_a_static_map_starts_with_its_usual_values():
    plugins = [{"name": "world", "type": "costmap_2d::StaticLayer"}]
    tree = {"global_costmap": {"plugins": plugins}, "local_costmap": {"plugins": plugins}}
    assert check(tree) == []
    assert MoveBase(tree).global_costmap.size == (200, 200)


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (changed("local_costmap/obstacles_layer/observation_sources", ["scan"]), ["observation_sources", "give text"]),
        (dict(BARE, local_costmap={"observation_sources": ["scan"]}), ["observation_sources", "give text"]),
        (changed("base_local_planner", ["a"]), ["base_local_planner", "give text"]),
        (changed("local_costmap/obstacles_layer/observation_sources", "front/scan"), ["'front/scan'", "letters"]),
        (changed("local_costmap/obstacles_layer/observation_sources", "enabled"), ["'enabled'", "no parameter's"]),
        (dict(BARE, local_costmap={"observation_sources": "front/scan"}), ["'front/scan'", "letters"]),
        (changed("local_costmap/plugins", [{"name": "a/b", "type": "costmap_2d::ObstacleLayer"}]), ["'a/b'"]),
        (changed("local_costmap/plugins", [{"name": "width", "type": "costmap_2d::ObstacleLayer"}]), ["'width'"]),
        (changed("local_costmap/plugins", [{"name": "a", "type": ["x"]}]), ["give a name and a type"]),
        (changed("recovery_behaviors", [{"name": "local_costmap", "type": CLEAR}]), ["'local_costmap'", "another"]),
        (changed("recovery_behaviors", [{"name": PLANNER, "type": TURN}]), ["'TrajectoryPlannerROS'", "another"]),
        (changed("recovery_behaviors", [{"name": "planner_frequency", "type": TURN}]), ["'planner_frequency'"]),
        (changed("recovery_behaviors", [{"name": "a b", "type": TURN}]), ["'a b'", "letters"]),
        (changed("recovery_behaviors", [{"type": TURN}]), ["give a name and a type"]),
        (changed("recovery_behaviors", [{"name": 5, "type": TURN}]), ["give a name and a type"]),
        (changed("local_costmap/footprint", "{[1]:2}"), ["local_costmap/footprint", "at least three points"]),
        (changed("local_costmap/footprint", [[10**400, 0], [1, 0], [0, 1]]), ["at least three points"]),
        (changed(PLANNER + "/sim_time", 10**400), ["TrajectoryPlannerROS/sim_time", "beyond 1e308"]),
        (changed(PLANNER + "/vx_samples", -(10**400)), ["TrajectoryPlannerROS/vx_samples", "beyond 1e308"]),
        (changed("local_costmap/resolution", 1e-200), ["cells"]),
        (changed(PLANNER + "/sim_granularity", 1e-9), ["sim_granularity is 1e-09", "more than 100000 points"]),
        (changed(PLANNER + "/angular_sim_granularity", 1e-9), ["angular_sim_granularity", "more than 100000 points"]),
        (changed("rotate_recovery/sim_granularity", 1e-9), ["rotate_recovery/sim_granularity", "100000 poses"]),
    ],
)
def test_a_tree_that_cannot_be_run_is_one_line(tree, words):
    one_line(tree, *words)


@pytest.mark.parametrize("name", ["sim_granularity", "angular_sim_granularity"])
def test_a_request_for_endless_trajectories_is_refused(name):
    config = Configuration(complete(JACKAL))
    with pytest.raises(ParameterError, match="%s is 1e-09.*more than 100000 points" % name):
        config.request(PLANNER, {name: 1e-9})
    slow = {"max_vel_x": 0.0, "min_vel_x": 0.0, "escape_vel": 0.0, "sim_granularity": 1e-9}
    config.request(PLANNER, slow)
    with pytest.raises(ParameterError, match="heading_scoring"):
        config.request(PLANNER, dict(slow, heading_scoring=True))


@pytest.mark.parametrize("text", ["{[1]: 2}", "[[%s, 0], [1, 0], [0, 1]]" % ("9" * 400)])
def test_a_footprint_of_another_kind_is_one_line(text):
    with pytest.raises(footprint.FootprintError, match="footprint"):
        footprint.parse(text)


def test_side_velocities_may_be_a_list_as_cpp_wants_them():
    assert check(changed(PLANNER + "/y_vels", [-0.3, -0.1, 0.1, 0.3])) == []


CLEARING = {"layer_names": ["obstacles_layer"], "affected_maps": "both", "force_updating": True}


def test_recovery_parameters_of_cpp_files_are_taken():
    tree = dict(
        JACKAL,
        conservative_reset=dict(CLEARING, reset_distance=3.0),
        aggressive_reset=dict(CLEARING, invert_area_to_clear=False),
        rotate_recovery={"frequency": 10.0},
        recovery_behaviors=[{"name": "wide", "type": CLEAR}, {"name": "turn", "type": TURN}],
        wide=dict(CLEARING, reset_distance=7.0),
        turn={"frequency": 5.0, "sim_granularity": 0.02},
    )
    assert check(tree) == []
    assert remark(tree) == []
    full = complete(tree)
    assert full["conservative_reset"]["layer_names"] == full["wide"]["layer_names"] == ["obstacles_layer"]
    assert complete(full) == full


@pytest.mark.parametrize(("name", "value"), [("affected_maps", "local"), ("invert_area_to_clear", True)])
def test_what_cpp_would_clear_otherwise_is_remarked(name, value):
    tree = changed("aggressive_reset/" + name, value)
    assert check(tree) == []
    assert remark(tree) == [
        "aggressive_reset/%s is without effect: a clearing clears both costmaps outside of its square" % name
    ]
