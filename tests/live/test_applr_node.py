"""Tests of the applr node with a fake move_base: decisions, faults (docs/reference/faults.md),
robots, methods.
"""

import re
import time
from typing import NamedTuple, Optional

import numpy as np
import pytest
import rosgraph
import rosnode
import rospy
from applr_ros1.msg import Parameters
from applr_ros1.srv import SetMethod
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Empty, EmptyResponse, SetBool

from applr_ros1.nodes import conversions
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy import methods
from applr_ros1.policy.actor import save
from applr_ros1.policy.observation import goal_angle, local_goal, observe
from applr_ros1.policy.parameter_space import SPACE, THETA_0, space_of
from applr_ros1.robots import load
from tests.support import lines_with
from tests.support.nodes import Standing, decided, observed
from tests.support.robots import JACKAL_PARAMETERS, make_weights
from tests.support.ros import LONGEST, Child, session, wait_for

pytestmark = pytest.mark.ros
# Ten times as often as on the robot, so that tests are fast [s].
PERIOD = 0.2
PLANNER = "/move_base/TrajectoryPlannerROS"
HURRIED = {  # constants of the node that are replaced for tests
    "applr_ros1.nodes.applr.node.REPORT_S": 0.1,
    "applr_ros1.nodes.applr.meter_scoring.PATIENCE_S": 0.3,
    "applr_ros1.nodes.applr.reconfigure_client.MOST_SEARCHES": 3,
    # On a busy machine a server's parameter_updates can come later than the usual limit.
    "applr_ros1.nodes.applr.reconfigure_client.ANNOUNCED_S": 5.0,
    # The fake robot stands: on a busy machine it would stall before a test ends.
    "applr_ros1.policy.stuck.STALL_TIME_S": 3600.0,
}
# Servers of the inflation in both costmaps.
LAYERS = ["/move_base/local_costmap/inflater_layer", "/move_base/global_costmap/inflater_layer"]


@pytest.fixture(scope="module")
def robot():
    """Return a Jackal at rest for all tests of this file."""
    session()
    robot = Standing()
    yield robot
    robot.close()


class Started(NamedTuple):
    """The applr node, and a client of its move_base's parameters; None unless the node is ready."""

    node: Child
    client: Optional[ReconfigureClient]


@pytest.fixture
def stack(robot, tmp_path):
    """Provide start(method, fake=[...], **private parameters) → Started.

    start.fake(*arguments) starts a fake move_base alone, and returns its Child.
    """
    ros = session()
    children = []
    clients = []
    robot.reset()

    def start_fake(*args):
        fake = ros.node("tests.support.nodes", *args)
        children.append(fake)
        fake.until("all up")
        return fake

    def start(
        method="applr",
        policy="",
        fake=(),
        weights=None,
        ready=True,
        constants=HURRIED,
        **parameters,
    ):
        if fake is not None:
            start_fake(*fake)
        if method == "applr":
            actor_file = tmp_path / "actor.safetensors"
            save(actor_file, make_weights(hidden=(16,)) if weights is None else weights)
            method = str(policy or actor_file)
        parameters = {"method": method, "period": PERIOD, **parameters}
        arguments = [f"_{name}:={value}" for name, value in parameters.items()]
        node = ros.node("applr", *arguments, constants=constants)
        children.append(node)
        if not ready:
            return Started(node, None)
        node.until(lambda: robot.values)
        client = ReconfigureClient()
        clients.append(client)
        wait_for(lambda: not client.connect(), "servers")
        return Started(node, client)

    start.fake = start_fake
    yield start
    robot.goal = None
    for client in clients:
        client.close()
    # Killed, because an orderly end would take seconds for each test.
    for child in reversed(children):
        child.kill()
    # Killed nodes are still registered.
    rosnode.cleanup_master_blacklist(rosgraph.Master("/test"), ["/move_base"])
    for parameter_name in ("/fake", "/use_sim_time"):
        if rospy.has_param(parameter_name):
            rospy.delete_param(parameter_name)


def reports(robot, message):
    """Wait until the node's diagnostics have a message."""
    wait_for(lambda: robot.values.get("message") == message, "diagnostics: " + message)


def as_set(robot, client):
    """Return whether the planner has the parameters of the latest decision in force."""
    return bool(robot.decisions) and robot.decisions[-1]["theta"] == SPACE.as_dict(client.theta())


def is_in_force(client, theta):
    """Wait until a parameter set (n,) is in force."""
    wait_for(lambda: np.array_equal(client.theta(), theta), f"the set {theta}")


def starts_deciding(robot, as_set_in=None):
    """Set a goal and wait for two decisions, with a client until the latter is in force."""
    robot.goal = "one"
    decides_again(robot, as_set_in, 0)


def decides_again(robot, as_set_in=None, since=None):
    """Wait until the number of decisions has grown by two, with a client until the latest is in
    force.
    """
    earlier_decisions = len(robot.decisions) if since is None else since

    def has_decided():
        # Two, because the first may have been under way already.
        if len(robot.decisions) < earlier_decisions + 2:
            return False
        return as_set_in is None or as_set(robot, as_set_in)

    wait_for(has_decided, "decisions")


def two_periods(robot):
    """Wait for two more periods of the node, which sends a heartbeat in each."""
    earlier_beats = len(robot.beats)
    wait_for(lambda: len(robot.beats) > earlier_beats + 2, "heartbeats")


def begins_with_the_last_set(robot):
    """Return whether the latest decision began with the parameters of the one before it."""
    previous_decision, latest_decision = robot.decisions[-2:]
    return latest_decision["theta_prev"] == previous_decision["theta"]


def test_a_decision_every_period_reaches_all_servers(robot, stack):
    node, client = stack()
    two_periods(robot)
    assert not robot.decisions  # Without a goal there are no decisions.
    is_in_force(client, THETA_0)
    robot.goal = "one"
    node.until(lambda: len(robot.decisions) >= 5 and as_set(robot, client))
    assert robot.decisions[0]["theta_prev"] == SPACE.as_dict(THETA_0)
    wait_for(
        lambda: begins_with_the_last_set(robot), "a decision that begins with the set in force"
    )
    stamps_ns = [float(decision["stamp"]) for decision in robot.decisions[:5]]
    intervals = np.diff(stamps_ns) / 1e9 / PERIOD
    assert intervals.sum() > 3.0
    assert intervals.min() < 1.25  # Other decisions may be late on a busy machine.

    # The first decision saw what the robot published.
    expected_observation = observe(
        robot.ranges, goal_angle(local_goal(robot.path, robot.pose)), THETA_0
    )
    np.testing.assert_allclose(observed(robot.messages[0]), expected_observation, atol=1e-6)

    # One parameter of the policy sets several of the servers.
    planner = client.servers["TrajectoryPlannerROS"].values
    assert planner["min_vel_theta"] == -planner["max_vel_theta"]

    def both_costmaps_inflate():
        """Return whether both costmaps have a decided inflation radius, not theta_0's 0.3 m."""
        layers = [server for role, server in client.servers.items() if "inflater" in role]
        return all(server.values["inflation_radius"] != 0.3 for server in layers)

    wait_for(both_costmaps_inflate, "both costmaps'")

    # What the node reports
    wait_for(lambda: len(robot.beats) >= 4, "heartbeats")
    wait_for(lambda: robot.count("applied") >= 5 and robot.values["goal"] == "one", "diagnostics")
    wait_for(lambda: robot.parameters[-1] == client.theta().tolist(), "the parameters in force")
    # On a busy machine, servers are late.
    late_server = re.compile("does not answer|busy with an earlier call")
    for warning in lines_with(node.text, "parameters not changed"):
        assert late_server.search(warning), warning

    # The course is over. The next course starts with theta_0.
    robot.goal = None
    is_in_force(client, THETA_0)
    wait_for(lambda: robot.ends, "the observation at the end of the course")
    (course_end,) = robot.ends

    values_at_the_end = decided(course_end)["theta_prev"]
    assert list(values_at_the_end) == list(SPACE.names)
    assert values_at_the_end != SPACE.as_dict(THETA_0)
    assert (course_end.goal, decided(course_end)["theta"]) == ("one", {})
    assert observed(course_end)[:721] == pytest.approx(expected_observation[:721], abs=1e-6)
    decision_count = len(robot.decisions)
    two_periods(robot)
    assert len(robot.decisions) == decision_count


def test_other_names_of_the_cpp_move_base(robot, stack):
    client = stack(fake=("--spelling", "kinetic", "--layer", "inflation_layer")).client
    starts_deciding(robot, client)
    assert client.servers["TrajectoryPlannerROS"].names["path_distance_bias"] == "pdist_scale"
    assert client.servers["local_costmap/inflater_layer"].name.endswith("inflation_layer")


def test_another_local_planner_is_named_in_one_line(robot, stack):
    node = stack(fake=("--without", "vtheta_samples"), ready=False).node
    warning = f"{PLANNER} has no parameter vtheta_samples"
    node.until(warning)
    assert node.text.count(warning) == 1


# -- run-time services, speed limit and diagnostics ------------------------------------------------
def service(name, kind, *arguments):
    """Call a service of the node, and return its answer."""
    rospy.wait_for_service("/applr/" + name, LONGEST)
    return rospy.ServiceProxy("/applr/" + name, kind)(*arguments)


def test_services_and_topics_switch_the_method_while_driving(robot, stack, tmp_path):
    """tests/policy/test_supervisor.py tests what is in force then."""
    node, client = stack("random", max_speed=1.6)
    reports(robot, "idle: no goal")
    starts_deciding(robot, client)
    reports(robot, "deciding")
    assert robot.values["driving"] == "the parameters of method random"

    # Off, the defaults are set once, and stay without decisions.
    defaults = "the robot's default parameters"
    assert service("enable", SetBool, False).message == f"off: {defaults} drive now"
    is_in_force(client, THETA_0)
    reports(robot, f"switched off: {defaults} drive now")
    decision_count = len(robot.decisions)
    two_periods(robot)
    assert len(robot.decisions) == decision_count
    assert np.array_equal(client.theta(), THETA_0)
    # On again, the course goes on.
    answer = service("enable", SetBool, True)
    assert answer.message == f"on, method random: {defaults} drive now"
    decides_again(robot, client)
    assert "the goal has ended" not in node.text, "move_base still pursues it"

    # Set by hand, below max_speed; refused values do not stop the method.
    publisher = rospy.Publisher("/applr/set_parameters", Parameters, queue_size=10)
    wait_for(publisher.get_num_connections, "the connection")
    publisher.publish(Parameters(names=["speed"], values=[1.0]))
    node.until("unknown parameter 'speed'")
    decides_again(robot)
    publisher.publish(Parameters(names=["max_vel_x"], values=[9.0]))
    wait_for(lambda: client.theta()[0] == 1.6, "the capped value")
    reports(robot, "switched off: the parameters set by hand drive now")

    # Another method
    fixed_set = tmp_path / "set.json"
    fixed_set.write_text('{"max_vel_x": 1.5}')
    assert service("enable", SetBool, True).success
    answer = service("set_method", SetMethod, str(fixed_set))
    assert (answer.success, answer.message) == (True, f"method {fixed_set}")
    wait_for(lambda: client.theta()[0] == 1.5, "the fixed set")
    assert not service("set_method", SetMethod, "fast").success
    wait_for(lambda: robot.values["method"] == str(fixed_set), "diagnostics")

    robot.goal = None
    node.until("the goal has ended")
    assert node.end() == 0
    is_in_force(client, THETA_0)
    assert "Traceback" not in node.text


@pytest.mark.fault("14c")
def test_costmaps_that_mark_obstacles_less_far_than_the_method_needs_are_said_in_one_line(
    robot, stack, tmp_path
):
    # Given: a move_base with the maker's files, and a set that was made for 5 m
    for costmap in ("global_costmap", "local_costmap"):
        rospy.set_param(f"/move_base/{costmap}", JACKAL_PARAMETERS[costmap])
    (tmp_path / "far.json").write_text('{"obstacle_range": 5.0, "parameters": {}}')
    node, _ = stack(str(tmp_path / "far.json"))

    # Then: its start and the diagnostics say what to write into the file
    node.until("up to 2.5 m, but method ")
    line = (
        r".*scan/obstacle_range: .* was made for 5 m; give obstacle_range: 5, raytrace_range: 5.5"
    )
    wait_for(lambda: re.fullmatch(line, robot.values["message"]), "diagnostics")

    # A method that needs nothing ends the warning.
    service("set_method", SetMethod, "dwa")
    reports(robot, "idle: no goal")


def test_a_dead_move_base_is_noticed_while_idle(robot, stack):
    stack("dwa")
    reports(robot, "idle: no goal")
    robot.statuses = False
    reports(robot, "move_base has stopped publishing its status: check that it is running")
    assert robot.values["level"] == 1
    robot.statuses = True
    reports(robot, "idle: no goal")
    assert robot.values["level"] == 0


def test_a_late_move_base_leaves_no_warning(robot, stack):
    stack("dwa", fake=None, ready=False)
    wait_for(
        lambda: robot.values.get("level") == 2 and "parameter" in robot.values["message"], "trouble"
    )
    stack.fake()
    reports(robot, "idle: no goal")
    assert robot.values["level"] == 0


def test_weights_per_metre_are_detected_and_rescaled(robot, stack, tmp_path):
    """A policy's distance biases are per cell. They are rescaled if the cost_cloud belongs to a
    planner per metre.
    """
    publisher = rospy.Publisher(PLANNER + "/cost_cloud", PointCloud2, queue_size=1)
    node, client = stack(period=0.3)
    robot.goal = "one"
    wait_for(lambda: as_set(robot, client), "decisions")
    wait_for(
        lambda: "no cost_cloud on" in robot.values["meter_scoring"], "the report of an unknown unit"
    )
    # A point a row: the position (x, y, z), then the costs.
    cost_cloud = np.random.default_rng(0).integers(0, 99, (400, 7)).astype(np.float64)
    cost_cloud[:, 0] = 0.05 * cost_cloud[:, 0]

    def detected():
        """Publish a cost cloud with the current parameters, and return whether the node has
        detected the unit.
        """
        # The total cost of a planner per metre on cells of 0.05 m: the unit can be told from it
        # alone. Columns 3 to 5 are the path, goal and occupancy costs.
        path_goal_and_occupancy = client.values()[[5, 6, 4]]
        weights = path_goal_and_occupancy * [0.05, 0.05, 1.0]
        cost_cloud[:, 6] = cost_cloud[:, 3:6] @ weights
        publisher.publish(
            conversions.cloud(cost_cloud, conversions.COST_FIELDS, "odom", rospy.Time.now())
        )
        time.sleep(0.1)
        return "pdist_scale x 2.5" in robot.values["meter_scoring"]

    wait_for(detected, "the factors in diagnostics")
    wait_for(lambda: not publisher.get_num_connections(), "the end of the subscription")
    assert node.text.count("count per metre") == 1
    robot.goal = None
    # The robot's default parameters are in the planner's own unit.
    is_in_force(client, THETA_0)
    assert node.end() == 0
    is_in_force(client, THETA_0)


# -- other robots and user-defined methods ---------------------------------------------------------
def test_another_robots_restarted_servers_get_the_set_again_and_the_defaults_at_the_end(
    robot, stack
):
    husky = load("husky")
    space = space_of(husky)
    fake = stack.fake("--robot", "husky")
    node = stack("static", fake=None, ready=False, robot="husky").node
    # The fixture's clients have the Jackal's parameters.
    client = ReconfigureClient(space=space)
    wait_for(lambda: not client.connect(), "servers")
    tuned_set = space.clip(methods.make("static", husky).theta(None))
    is_in_force(client, tuned_set)
    # A crash: new servers have the values of the files.
    fake.kill()
    stack.fake("--robot", "husky")
    wait_for(lambda: robot.count("restarts") == len(space.servers), "every server again")
    is_in_force(client, tuned_set)
    assert node.end() == 0, node.text
    is_in_force(client, space.theta0)
    assert "Traceback" not in node.text
    client.close()


def test_the_defaults_return_at_the_nodes_end_although_one_server_is_frozen(robot, stack):
    node, client = stack("static")
    tuned_set = SPACE.clip(methods.make("static").theta(None))
    is_in_force(client, tuned_set)
    rospy.set_param("/fake/hang", LAYERS[:1])
    assert service("set_method", SetMethod, "dwa").success
    node.until("does not answer")
    assert node.end() == 0, node.text
    defaults = SPACE.settings(THETA_0)

    def others_have_defaults():
        for role, server in client.servers.items():
            if server.name != LAYERS[0] and not server.has_set(server.bounded(defaults[role])):
                return False
        return True

    wait_for(others_have_defaults, "theta_0 of the others")
    rospy.delete_param("/fake/hang")


def test_a_stalled_robot_leaves_its_constant_set_and_its_costmaps_are_cleared(
    robot, stack, monkeypatch
):
    hurried_stalls = {**HURRIED, "applr_ros1.policy.stuck.STALL_TIME_S": 0.5}
    node, client = stack("static", constants=hurried_stalls)
    tuned_set = SPACE.clip(methods.make("static").theta(None))
    is_in_force(client, tuned_set)
    robot.goal = "one"
    wait_for(lambda: robot.count("stalls") > 1, "two decisions in a stall")
    wait_for(lambda: not np.array_equal(client.theta(), tuned_set), "random parameters")
    node.until("costmaps not cleared: service [/move_base/clear_costmaps] unavailable")
    # The decisions say when clearing was asked for.
    assert not robot.messages[0].cleared
    assert any(message.cleared for message in robot.messages)
    # Its odometry says that it drives at 0.5 m/s: the stall is over.
    monkeypatch.setattr(robot.robot, "twist", (0.5, 0.0))
    is_in_force(client, tuned_set)

    # The next stall finds the service.
    clear_requests = []

    def clear_costmaps(request):
        clear_requests.append(request)
        return EmptyResponse()

    clearing_service = rospy.Service("/move_base/clear_costmaps", Empty, clear_costmaps)
    monkeypatch.undo()
    wait_for(lambda: clear_requests, "cleared costmaps")
    clearing_service.shutdown()
