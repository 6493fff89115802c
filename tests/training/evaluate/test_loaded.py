"""Tests of parameter sets loaded at the start of move_base, as from a file, and of those set by
reconfigure.
"""

from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from applr_ros1 import robots
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.policy.stall_rule import StallRule
from applr_ros1.robots.robot import MoveBaseSetup
from tests.support.robots import make_weights
from training.attempts.loaded import loadable_space
from training.env.settings import TrialSettings
from training.evaluate.runner import TrialRunner
from training.evaluate.trial import POLICY, Trial

SET = {
    "max_vel_x": 0.9,
    "footprint_padding": 0.14,
    "min_in_place_vel_theta": 0.75,
    "vx_samples": 9,
}


@pytest.mark.parametrize(
    ("loaded", "in_maps", "slowest"),
    [
        (True, 0.1, 0.75),
        (False, 0.14, 0.314),
    ],
)
def test_parameters_read_at_start_come_from_a_loaded_set_and_else_from_the_robots_files(
    loaded, in_maps, slowest, monkeypatch
):
    """A footprint padding that is loaded would also change the planner's outline, so a YAML file
    leaves it out.
    """
    # Given: a runner whose MoveBase and reconfigure requests are watched
    created = []
    requested_servers = []
    original = MoveBase.reconfigure

    def create(*arguments, **keywords):
        created.append(MoveBase(*arguments, **keywords))
        return created[-1]

    def reconfigure(move_base, server, values):
        requested_servers.append(server)
        return original(move_base, server, values)

    monkeypatch.setattr(MoveBase, "reconfigure", reconfigure)
    monkeypatch.setattr("training.env.settings.MoveBase", create)
    runner = TrialRunner(TrialSettings(planner="cpp-like", loaded=loaded, time_limit=2.0))

    # When: it drives a trial with a set
    theta = SPACE.from_dict(SET)
    task = Trial("generated:7", "m", 0, 1, "generated:7", "", theta=tuple(theta.tolist()))
    runner.run(task)

    # Then: a loaded set needs no requests, and the stall rule does not change it
    (move_base,) = created
    in_force = {**SPACE.as_dict(theta), "footprint_padding": in_maps}
    assert runner.drive.decisions[-1].after == in_force
    assert bool(requested_servers) != loaded
    assert runner.simulated.stack.escapes != loaded
    # The planner has the outline of the robot's files, and reads its slowest turn at the start.
    half_sides = np.abs(move_base.local_planner.planner.footprint).max(axis=0)
    assert half_sides.tolist() == pytest.approx([0.21 + 0.1, 0.165 + 0.1])
    length, _ = np.ptp(move_base.local_costmap.footprint, axis=0)
    assert length == pytest.approx(0.42 + 2 * in_maps)
    assert move_base.local_planner.slowest_turn == slowest


@pytest.mark.parametrize("loaded", [True, False])
def test_a_set_that_is_set_by_reconfigure_gives_way_in_a_stall_and_a_loaded_one_stays(
    loaded, monkeypatch
):
    # Given: a stall rule that redraws in each decision, and is watched
    slow_theta = SPACE.from_dict({**SET, "max_vel_x": 0.2})
    seeds = []
    cleared_move_bases = []
    original_reset = StallRule.begin_course

    def redraw(self, method, context, theta):
        self.clears_costmaps = method.redraws_stalled
        return slow_theta if method.redraws_stalled else None

    def begin_course(self, seed):
        seeds.append(seed)
        return original_reset(self, seed)

    monkeypatch.setattr(StallRule, "redraw", redraw)
    monkeypatch.setattr(StallRule, "begin_course", begin_course)
    monkeypatch.setattr(MoveBase, "clear_costmaps", lambda self: cleared_move_bases.append(self))

    # When: a trial with the seed 5 is driven
    runner = TrialRunner(TrialSettings(loaded=loaded, time_limit=2.0))
    theta = tuple(SPACE.from_dict(SET).tolist())
    runner.run(Trial("generated:7", "m", 0, 5, "generated:7", "", theta=theta))

    # Then: only a set by reconfigure gave way
    speed_limit = 0.9 if loaded else 0.2
    assert runner.drive.decisions[-1].after["max_vel_x"] == speed_limit
    assert seeds[-1] == 5
    assert bool(cleared_move_bases) != loaded
    assert {decision.cleared for decision in runner.drive.decisions} == {not loaded}


def test_a_search_leaves_out_parameters_that_act_differently_by_reconfigure():
    jackal = loadable_space(robots.JACKAL)
    assert jackal.fixed == ("footprint_padding",)
    searched_names = list(SPACE.names)
    searched_names.remove("footprint_padding")
    assert jackal.chosen.names == tuple(searched_names)

    # A search knows the chosen parameters only; the others are filled in with their defaults.
    sets = np.array([SPACE.from_dict(SET), SPACE.theta0])
    filled_set, filled_defaults = map(jackal.fill, jackal.chosen_of(sets))
    assert jackal.as_dict(filled_set)["footprint_padding"] == 0.1
    assert filled_defaults.tolist() == SPACE.theta0.tolist()

    waffle = robots.load("turtlebot3_waffle_pi")
    assert loadable_space(waffle).chosen.names == space_of(waffle).names
    burger = robots.load("turtlebot3_burger")
    assert "footprint_padding" in loadable_space(burger).chosen.names, (
        "DWAPlannerROS reads it in every cycle"
    )


@pytest.fixture
def started(monkeypatch):
    """Return the obstacle and raytrace ranges [m] with which each MoveBase of a runner starts."""
    ranges = []

    def create(*arguments, **keywords):
        move_base = MoveBase(*arguments, **keywords)
        (buffer,) = move_base.global_costmap.obstacle_layers[0].buffers
        ranges.append((buffer.source.obstacle_range, buffer.source.raytrace_range))
        return move_base

    monkeypatch.setattr("training.env.settings.MoveBase", create)
    return ranges


@pytest.mark.parametrize("loaded", [True, False])
def test_a_sets_obstacle_range_is_that_of_its_costmaps_and_never_of_the_baselines(
    loaded, started, tmp_path
):
    runner = TrialRunner(TrialSettings(planner="cpp-like", loaded=loaded, time_limit=1.0))
    set_file = tmp_path / "far.json"
    set_file.write_text('{"obstacle_range": 5.0, "parameters": {"max_vel_x": 0.9}}')
    for method in (str(set_file), "dwa"):
        runner.run(Trial("generated:7", "m", 0, 1, "generated:7", method))
    # A trial of a search
    theta = tuple(SPACE.theta0.tolist())
    runner.run(Trial("generated:7", "m", 0, 1, "generated:7", "", theta=theta, obstacle_range=4.0))
    assert started == [(5.0, 5.5), (2.5, 3.0), (4.0, 4.5)]


def test_a_loaded_sets_obstacle_range_is_also_that_of_the_setup_with_a_map(started):
    # Given: a robot whose global costmap has another layer with a map
    waffle = robots.load("turtlebot3_waffle_pi")
    without_map, with_map = waffle.move_base
    layer = {
        "observation_sources": "scan",
        "scan": {"topic": "scan", "data_type": "LaserScan", "marking": True, "clearing": True},
    }
    plugins = [
        {"name": "static", "type": "costmap_2d::StaticLayer"},
        {"name": "seen", "type": "costmap_2d::ObstacleLayer"},
        {"name": "inflated", "type": "costmap_2d::InflationLayer"},
    ]
    with_layer = merged(with_map, {"global_costmap": {"plugins": plugins, "seen": layer}})
    robot = replace(waffle, move_base=MoveBaseSetup(without_map, with_layer))
    runner = TrialRunner(TrialSettings(robot=robot, loaded=True))
    # Then: both its planners have the range
    runner.starting_with(runner.space.theta0, obstacle_range=1.5)
    assert started == [(1.5, 2.0)] * 2


def test_the_policy_of_a_training_is_tried_with_the_range_with_which_it_learns(started):
    runner = TrialRunner(TrialSettings(obstacle_range=4.0, time_limit=1.0))
    weights = safetensors.numpy.save(make_weights(hidden=(8,)))
    for method in (POLICY, "dwa"):
        runner.run(Trial("generated:7", "m", 0, 1, "generated:7", method), weights)
    assert started == [(4.0, 4.5), (2.5, 3.0)]
