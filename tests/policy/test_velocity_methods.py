"""Methods that command velocities: their contract, trials with them, mistakes, and the node that drives with one."""

import json
import math
import time
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy import methods
from tests.support import ROOT
from training.actors.tasks import Trial
from training.env.episode import Episode
from training.evaluation.trials import TrialRunner

PURSUIT = "%s:Pursuit" % (ROOT / "examples" / "07_own_controller" / "pursuit.py")


class Steer:
    def reset(self, seed):
        self.draws = np.random.default_rng(seed)

    def command(self, context):
        return self.draws.uniform(), context.phi


class Nan(Steer):
    def command(self, context):
        return 0.5, math.nan


class Three(Steer):
    def command(self, context):
        return 0.5, 0.0, 0.0


class Unseeded(Steer):
    def command(self, context):
        return np.random.default_rng().uniform(), 0.0


class Bends(Steer):
    def command(self, context):
        context.plan[:] = 0.0
        return 0.0, 0.0


def test_contract():
    own = methods.UserMethod(Steer(), "Steer")
    assert own.commands
    assert not own.static
    assert own.period == methods.COMMAND_PERIOD == 0.05
    methods.check_method(Steer())
    methods.check_method(methods.make(PURSUIT))
    for broken, line in (
        (Nan, "not finite"),
        (Three, "too many values"),
        (Unseeded, "other velocities"),
        (Bends, "changed"),
    ):
        with pytest.raises(ApplrError, match=line) as error:
            methods.check_method(broken())
        assert "\n" not in str(error.value)
    with pytest.raises(ApplrError, match="velocity_method.launch"):
        methods.make(PURSUIT, commands=False)
    with pytest.raises(ApplrError, match="no parameters to hold"):
        methods.make("frozen:max_vel_x:" + PURSUIT)


def test_reaches_goals_at_its_own_rate_and_the_same_way_each_time():
    runner = TrialRunner("kinematic")
    task = Trial("w", "m", 0, 11, "generated:0", PURSUIT + ":0.8", "ours", trace=True)
    for world in ("generated:7", "generated:64", "generated:0"):
        answer = runner.run(replace(task, world_spec=world))
        assert answer.result.success, world
        assert not answer.result.collided
        assert answer.result.decisions == math.ceil(answer.result.time_s / 0.1 - 1e-6)
        assert answer.result.switching == 0.0
    # what another method drove before or with the same planner changes nothing, there and here
    planner = runner.run(replace(task, method_spec="fast_dwa")).result
    assert planner == TrialRunner("kinematic").run(replace(task, method_spec="fast_dwa")).result
    assert runner.run(task) == answer


@pytest.fixture
def episode():
    import sim_bridge

    return Episode(
        sim_bridge.make("kinematic"), MoveBase(robots.JACKAL.parameters()), limit=20, period=0.5, record=True
    )


def test_the_commands_reach_the_base_and_the_planner_never_gives_up(episode):
    import worlds

    world = worlds.load("generated:0")
    episode.reset(world, 0)
    with pytest.raises(RuntimeError, match="take_over"):
        episode.drive(0.5, 0.0)
    episode.reset(world, 0)
    episode.take_over()
    before = episode.context()
    assert before.goal == episode.goal
    assert len(before.plan) == 0
    for _ in range(2):
        outcome = episode.drive(-0.4, 0.0)  # planners do not drive so, and are stuck soon
    assert set(episode.trace.command) == {(-0.4, 0.0)}
    assert episode.trace.theta == []
    after = episode.context()
    assert after.pose[1] < before.pose[1] - 0.2
    assert after.twist[0] == pytest.approx(-0.4, abs=0.1)
    assert math.dist(after.plan[-1, :2], after.goal[:2]) < 0.3
    while not outcome.over:
        outcome = episode.drive(0.0, 0.0)  # stands longer than a planner is patient with an oscillation
    assert (outcome.reason, outcome.decisions) == ("time limit", 20)
    episode.reset(world, 0)
    assert episode.decide(episode.space.theta0).path_length_m > 0.0  # the planner drives again


@pytest.mark.parametrize("turn", [0.6, 0.0], ids=["in circles", "held back for long"])
def test_the_monitor_checks_the_commands(episode, turn):
    import worlds

    episode.monitor = CollisionMonitor()
    episode.time_limit, episode.end_on_collision = 30.0, True
    outcome = episode.reset(worlds.load("generated:42"), 0)
    episode.take_over()
    while not outcome.over:
        outcome = episode.drive(0.5, turn)  # into whatever is there
    assert outcome.reason == "time limit"  # nor does the planner, of which nothing is held back, give the goal up


def test_the_launch_file_keeps_what_is_held_back_of_the_method_from_move_base():
    """With it move_base would count it as its own commands being held back, and give the goal up."""
    launch = ElementTree.parse(ROOT / "applr_ros1" / "launch" / "velocity_method.launch").getroot()
    (planner,) = (node for node in launch.iter("node") if node.get("type") == "move_base.py")
    moved = {remap.get("from"): remap.get("to") for remap in planner.iter("remap")}
    assert moved["collision_monitor/held_back"].startswith("move_base/")


@pytest.mark.ros
def test_the_node_commands_while_there_is_a_goal(tmp_path):
    import rospy
    from geometry_msgs.msg import PoseStamped, Twist

    from tests.support.fake_robot import Robot
    from tests.support.ros_harness import session, wait_for

    ros, robot, heard = session(), Robot(), []
    (tmp_path / "teller.py").write_text(
        "import json\n\n\nclass Teller:\n    period = 0.4\n\n    def command(self, context):\n"
        "        told = *context.pose, *context.twist, *context.goal, len(context.plan), context.phi\n"
        "        print(json.dumps(told), flush=True)\n"
        "        return 0.3, context.phi\n"
    )
    goal = rospy.Publisher("/move_base/current_goal", PoseStamped, queue_size=1, latch=True)
    rospy.Subscriber("/cmd_vel", Twist, lambda message: heard.append((message.linear.x, message.angular.z)))
    message = PoseStamped()
    message.pose.position.x, message.pose.orientation.w = 5.0, 1.0
    goal.publish(message)
    node = ros.python("-m", "applr_ros1.scripts.velocity", "_method:=%s:Teller" % (tmp_path / "teller.py"))
    try:
        wait_for(lambda: "ready" in node.text or not node.alive(), 10.0, "velocity node")
        assert node.alive(), node.text
        time.sleep(0.3)
        assert not heard  # no goal: it leaves the base alone
        robot.goal = "one"
        wait_for(lambda: len(heard) >= 6, 5.0, "commands")
        told = [json.loads(line) for line in node.text.splitlines() if line.startswith("[0.5,")]
        assert told[-1][:9] == pytest.approx([*robot.pose, *robot.twist, 5.0, 0.0, 0.0, len(robot.path)])
        assert heard[-1] == pytest.approx((0.3, told[-1][9]))
        assert len(heard) > 2 * len(told)  # again and again: the base stops where commands cease
        robot.ranges = None  # the laser falls silent: it stands
        wait_for(lambda: heard[-1] == (0.0, 0.0), 5.0, "stop")
        assert "standing: scan on /front/scan" in node.text
        robot.reset()
        robot.goal = "two"
        wait_for(lambda: heard[-1][0] == 0.3, 5.0, "commands again")
        robot.goal = None
        wait_for(lambda: heard[-1] == (0.0, 0.0), 5.0, "stop at the goal's end")
    finally:
        robot.close()
        node.end()
        goal.unregister()
    refused = ros.python("-m", "applr_ros1.scripts.velocity", "_method:=dwa")
    assert refused.process.wait(10.0) == 1
    assert refused.text.splitlines() == ["velocity: method dwa chooses parameters: start it with jackal_applr.launch"]


@pytest.mark.parametrize("step", [0.3, 30.0])
def test_after_a_step_of_the_clock_back_no_old_command_is_sent(monkeypatch, step):
    """On a wall clock, where rospy does not notice it."""
    import rospy

    from applr_ros1.nodes.applr import velocity_node

    clock, sent, slept = [100.0], [], []
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time.from_sec(clock[0]))
    monkeypatch.setattr(rospy, "is_shutdown", lambda: len(slept) >= 40)
    monkeypatch.setattr(rospy, "on_shutdown", lambda _: None)
    monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
    monkeypatch.setattr(velocity_node.VelocityNode, "_context", lambda self, now: now.to_sec())
    publisher = SimpleNamespace(publish=lambda m: sent.append((clock[0], m.linear.x)))
    monkeypatch.setattr(rospy, "Publisher", lambda *_, **__: publisher)

    def sleep(seconds):
        slept.append(seconds)
        clock[0] += 0.05 - (step if len(slept) == 20 else 0.0)

    monkeypatch.setattr(rospy, "sleep", sleep)
    method = SimpleNamespace(period=0.05, reset=lambda seed: None, command=lambda now: (now, 0.0))
    inputs = SimpleNamespace(goal=lambda now: "goal", clear=lambda: None)
    velocity_node.VelocityNode(method, inputs).spin()
    moving = [(now, v) for now, v in sent if v]
    assert len(moving) >= 39
    assert all(v == pytest.approx(now) for now, v in moving)
