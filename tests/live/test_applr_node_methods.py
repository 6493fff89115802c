"""The applr node with other robots' parameters, and with methods of a person's own."""

import json

import numpy as np
import pytest

from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import THETA_0, space_of
from applr_ros1.robots import load
from tests.support.ros_harness import wait_for

pytestmark = pytest.mark.ros
pytest_plugins = ("tests.support.applr_node_stack",)


def test_a_robot_with_other_parameters_gets_its_set_again_and_its_defaults_back(robot, stack):
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient

    husky = load("husky")
    space = space_of(husky)
    node, fake, _ = stack("static", fake=("--robot", "husky"), ready=False, robot="husky")
    client = ReconfigureClient(space=space)
    wait_for(lambda: not client.connect(), 5.0, "servers")
    best = space.clip(methods.make("static", husky).theta(None))
    wait_for(lambda: np.array_equal(client.theta(), best), 10.0, "the static set")
    fake.kill()
    stack.fake("--robot", "husky")
    wait_for(lambda: robot.count("restarts") and np.array_equal(client.theta(), best), 10.0, "the set again")
    assert node.end() == 0, node.text
    assert np.array_equal(client.theta(), space.theta0)
    assert "Traceback" not in node.text
    client.close()


def test_a_method_of_ones_own_sees_what_evaluation_shows_it(robot, stack, tmp_path):
    (tmp_path / "teller.py").write_text(
        "import json\n\n\nclass Teller:\n    def theta(self, context):\n"
        "        print(json.dumps([*context.pose, *context.twist, *context.goal, *context.plan[-1]]), flush=True)\n"
        "        return context.theta\n"
    )
    node, _, _ = stack("%s:Teller" % (tmp_path / "teller.py"))
    robot.goal = "one"
    wait_for(lambda: len(robot.decisions) >= 2, 5.0, "decisions")
    told = [json.loads(line) for line in node.text.splitlines() if line.startswith("[0.5,")]
    end = robot.path[-1]  # move_base stated its goal before the node heard it: the plan's end stands for it
    assert told[-1] == pytest.approx([*robot.pose, *robot.twist, *end, 0.0, *end])
    assert node.text.count("decision refused") == 0


FAULTY = """\
class Careless:
    static = True
    def theta(self, context):
        return context.theta

class Restless:
    def reset(self, seed):
        raise RuntimeError("no map")
    def theta(self, context):
        return context.theta
"""


def test_methods_of_ones_own_that_raise_leave_the_planner_driving(robot, stack, tmp_path):
    (tmp_path / "faulty.py").write_text(FAULTY)
    node, _, client = stack("%s:Careless" % (tmp_path / "faulty.py"))
    wait_for(lambda: "gave no parameters: AttributeError" in robot.values["message"], 4.0, "diagnostics")
    assert np.array_equal(client.theta(), THETA_0)
    assert node.end() == 0
    node, _, _ = stack("%s:Restless" % (tmp_path / "faulty.py"), fake=None)
    robot.goal = "one"
    wait_for(lambda: len(robot.decisions) >= 2, 5.0, "decisions")
    assert "cannot begin a course: RuntimeError: no map" in node.text
