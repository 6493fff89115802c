"""Tests of parameters that set several values, to which the robot's files give different ones."""

from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.policy.pilot import Pilot
from applr_ros1.robots import load
from applr_ros1.robots.learned import default_space
from applr_ros1.robots.robot import MoveBaseSetup
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from tests.support.servers import running_servers
from training.env.settings import TrialSettings
from training.evaluate.runner import TrialRunner, at_scale
from training.evaluate.trial import Trial
from worlds.occupancy import occupancy

PLANNER = "DWAPlannerROS"
INFLATION = ("local_costmap/inflation_layer", "global_costmap/inflation_layer")
# Both values of inflation_radius lie outside the range that a policy may choose from.
BURGER = load("turtlebot3_burger").with_parameters(
    {
        PLANNER: {"max_vel_x": 0.2, "max_vel_trans": 0.15},
        "local_costmap": {"inflation_radius": 0.35},
        "global_costmap": {"inflation_radius": 0.0},
    },
    "burger of two speeds",
)


def assert_owners(settings):
    """Check that settings are those of the robot's files."""
    assert settings[PLANNER]["max_vel_x"] == 0.2
    assert settings[PLANNER]["max_vel_trans"] == 0.15
    radii = [settings[server]["inflation_radius"] for server in INFLATION]
    assert radii == [0.35, 0.0]


def assert_together(settings, speed, radius):
    """Check that linked values are equal."""
    assert settings[PLANNER]["max_vel_x"] == settings[PLANNER]["max_vel_trans"] == speed
    radii = [settings[server]["inflation_radius"] for server in INFLATION]
    assert radii == [radius, radius]


def in_force(move_base):
    """Return the present settings of a planner's servers."""
    return Settings({name: move_base.configuration(name) for name in move_base.servers})


@pytest.fixture(scope="module")
def space():
    """Return the robot's parameter space."""
    return space_of(BURGER)


def test_theta_0_gives_each_value_back_to_the_robots_files(space):
    move_base = MoveBase(BURGER.parameters())
    start_up = in_force(move_base)
    assert_owners(space.settings(space.theta0))

    # A policy's set applies one number to all values of a parameter.
    chosen = space.from_dict({"max_vel_x": 0.18, "inflation_radius": 0.5})
    assert_together(move_base.put_in_force(space.settings(chosen)), 0.18, 0.5)

    move_base.put_in_force(space.settings(space.theta0))
    assert in_force(move_base) == start_up
    assert space.read_back(start_up).tolist() == space.theta0.tolist()


def test_a_set_leaves_the_parameters_that_it_does_not_have_as_the_owner_has_them(space):
    assert_owners(space.settings(space.from_dict({"sim_time": 2.0})))
    # As a policy in the paper's encoding, which does not choose all parameters
    assert space.chosen.settings(space.chosen.theta0)[PLANNER]["max_vel_trans"] == 0.15


@pytest.mark.parametrize(
    ("max_speed", "speeds"),
    [(np.inf, (0.2, 0.15)), (0.18, (0.18, 0.15)), (0.1, (0.1, 0.1))],
)
def test_a_speed_limit_lowers_each_speed_and_raises_none(space, max_speed, speeds):
    pilot = Pilot(methods.make("dwa", BURGER), BURGER, max_speed=max_speed)
    in_planner = pilot.space.settings(pilot.defaults().theta)[PLANNER]
    assert (in_planner["max_vel_x"], in_planner["max_vel_trans"]) == speeds
    fastest = pilot.space.settings(pilot.space.clip(space.high))[PLANNER]
    assert max(fastest["max_vel_x"], fastest["max_vel_trans"]) <= max_speed
    assert_owners(space.settings(space.theta0))


def test_a_speed_limit_finds_the_speed_under_any_name_of_the_parameter():
    speed = next(parameter for parameter in BURGER.space if parameter.name == "max_vel_x")
    renamed = speed.model_copy(update={"name": "speed"})
    described = replace(BURGER, name="burger with a speed", space=(renamed,))
    limited_space = space_of(described).below(0.1)
    assert limited_space.as_dict(limited_space.high)["speed"] == 0.1


def test_the_default_method_and_a_course_in_simulation_begin_with_the_owners_values(space):
    method = methods.make("dwa", BURGER)
    assert_owners(space.settings(method.theta(None)))

    simulator = sim_bridge.make("kinematic", robot=BURGER)
    move_base = MoveBase(BURGER.parameters())
    simulated = SimulatedRobot(simulator, Stack(BURGER, move_base, monitor=False))
    world = worlds.load("generated:3")
    course_drive = CourseDrive(simulated, world, seed=1, theta=space.theta0)
    assert_owners(in_force(move_base))
    # A drive with the parameters that are in force changes none of them.
    course_drive.decide(course_drive.theta)
    course_drive.advance()
    assert_owners(in_force(move_base))
    simulator.close()


def test_the_client_restores_the_owners_values_and_keeps_them_below_a_speed_limit(space):
    pytest.importorskip("rospy")
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient

    def started_client(space):
        client = ReconfigureClient(space=space)
        client.servers = running_servers(space, Settings.from_tree(BURGER.all_parameters()))
        return client

    def applied(client, theta):
        return not client.apply(client.space.settings(theta))

    def values_of(client):
        return {name: server.values for name, server in client.servers.items()}

    client = started_client(space)
    assert applied(client, space.from_dict({"max_vel_x": 0.18, "inflation_radius": 0.5}))
    assert_together(values_of(client), 0.18, 0.5)
    assert applied(client, space.theta0)
    assert_owners(values_of(client))
    assert client.theta().tolist() == space.theta0.tolist()

    pilot = Pilot(methods.make("dwa", BURGER), BURGER, max_speed=0.18)
    client = started_client(pilot.space)
    assert applied(client, pilot.defaults().theta)
    assert values_of(client)[PLANNER]["max_vel_x"] == 0.18
    assert values_of(client)[PLANNER]["max_vel_trans"] == 0.15
    # What is in force, applied again, changes nothing.
    assert applied(client, client.theta())
    assert values_of(client)[PLANNER]["max_vel_trans"] == 0.15


def slower_on_a_map(described):
    """Return a robot whose files for a map have other speeds, and these."""
    without_map, with_map = described.move_base
    slower = {PLANNER: {"max_vel_x": 0.15, "max_vel_trans": 0.15}}
    move_base = MoveBaseSetup(without_map, merged(with_map, slower))
    return replace(described, move_base=move_base), slower


def test_theta_0_is_that_of_the_files_in_use():
    described = load("turtlebot3_burger")
    slower_on_map, slower = slower_on_a_map(described)
    for robot, speed in ((slower_on_map, 0.22), (slower_on_map.on_map(), 0.15), (described, 0.22)):
        space = space_of(robot)
        assert space.theta0[space.names.index("max_vel_x")] == speed
        assert space.settings(space.theta0)[PLANNER]["max_vel_x"] == speed
    # Other parameters under the same name are another robot.
    slower_everywhere = described.with_parameters(slower, described.name)
    assert slower_everywhere != described
    assert space_of(slower_everywhere).defaults[PLANNER]["max_vel_x"] == 0.15


@pytest.mark.parametrize(("has_map", "speed"), [(False, 0.22), (True, 0.15)])
def test_a_simulated_drive_has_theta_0_of_the_files_in_use(has_map, speed, monkeypatch):
    robot, _ = slower_on_a_map(load("turtlebot3_burger"))

    def with_map(*arguments, **keywords):
        """Return a world of the runner with its map."""
        world = at_scale(*arguments, **keywords)
        return replace(world, map=occupancy(world, 0.05))

    if has_map:
        monkeypatch.setattr("training.evaluate.runner.at_scale", with_map)
    runner = TrialRunner(TrialSettings(robot=robot, time_limit=2.0))
    runner.run(Trial("generated:3", "dwa", 0, 1, "generated:3", "dwa"))
    first_decision = runner.drive.decisions[0]
    # The planner starts with these values, and the method does not change them.
    assert first_decision.before["max_vel_x"] == first_decision.after["max_vel_x"] == speed


def test_two_paddings_are_one_parameter_that_keeps_both():
    two_paddings = {"global_costmap": {"footprint_padding": 0.02}}
    described = BURGER.with_parameters(two_paddings, "burger of two paddings")
    default_parameters = default_space(described.base, described.body, described.parameters())
    space = space_of(replace(described, space=default_parameters))
    settings = space.settings(space.theta0)
    assert settings["local_costmap"]["footprint_padding"] == 0.01
    assert settings["global_costmap"]["footprint_padding"] == 0.02


def test_where_the_files_agree_theta_0_is_one_number_per_parameter():
    values = SPACE.as_dict(SPACE.theta0)
    for index, target in SPACE.addresses:
        default = SPACE.defaults[target.server][target.name]
        assert default == target.signed(values[SPACE.names[index]])
