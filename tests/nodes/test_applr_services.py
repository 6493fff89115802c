"""Tests of the applr node's services and start, without a ROS master."""

from types import SimpleNamespace

import pytest
import rospy
from applr_ros1.srv import SetMethodRequest

from applr_ros1.nodes.applr import main
from applr_ros1.nodes.applr.node import ApplrNode
from applr_ros1.policy import methods
from applr_ros1.policy.actor import save
from applr_ros1.robots import JACKAL
from tests.support.robots import make_weights


class Node:
    """Stands for an ApplrNode, as far as the service ~set_method needs it."""

    def __init__(self, method="random"):
        self.robot = JACKAL
        self.method = methods.make(method)

    def change_method(self, method):
        self.method = method


def set_method(node, spec, started_spec=""):
    """Call the service, and return (success, message)."""
    answer = main.set_method(node, started_spec, SetMethodRequest(spec))
    return answer.success, answer.message


@pytest.fixture
def user_code(tmp_path):
    """Return the specification of a user's method, whose import leaves the file `it_ran`."""
    code = "from applr_ros1.policy.methods import Method\nclass Own(Method): pass\n"
    mark = "open(%r, 'w').close()\n" % str(tmp_path / "it_ran")
    (tmp_path / "own.py").write_text(code + mark)
    return str(tmp_path / "own.py") + ":Own"


def test_a_method_is_changed_by_its_specification(tmp_path):
    fixed_set = tmp_path / "set.json"
    fixed_set.write_text('{"max_vel_x": 1.5}')
    node = Node()
    assert set_method(node, str(fixed_set)) == (True, f"method {fixed_set}")
    assert node.method.theta(None)[0] == 1.5

    # An empty name makes the method anew, such as after a change of the file.
    fixed_set.write_text('{"max_vel_x": 1.2}')
    assert set_method(node, "")[0]
    assert node.method.theta(None)[0] == 1.2


@pytest.mark.parametrize(
    ("spec", "problem"),
    [("none.safetensors", "none.safetensors"), ("fast", "method 'fast' is unknown")],
)
def test_a_method_that_cannot_be_had_leaves_the_one_that_drives(spec, problem):
    node = Node()
    success, message = set_method(node, spec)
    assert not success
    assert problem in message
    assert "\n" not in message
    assert node.method.name == "random"


def test_the_service_imports_no_code_but_that_with_which_the_node_was_started(user_code, tmp_path):
    """Anybody can call the service."""
    node = Node()
    success, message = set_method(node, user_code)
    assert not success
    assert "start the node with _method:=" in message
    assert not (tmp_path / "it_ran").exists()

    assert set_method(node, user_code, started_spec=user_code)[0]
    assert node.method.name == user_code


@pytest.mark.fault("9")
def test_a_policy_that_is_missing_or_cut_short_leaves_the_defaults(tmp_path):
    cut_file = tmp_path / "cut.safetensors"
    save(cut_file, make_weights())
    # As a copy over a bad connection leaves it.
    cut_file.write_bytes(cut_file.read_bytes()[:1000])
    for policy in ("none.safetensors", str(cut_file)):
        method, trouble = main.make_method(policy, JACKAL, "")
        assert policy in trouble
        assert "\n" not in trouble
        assert method.name == "dwa"


def test_the_answer_of_enable_says_what_drives():
    switched = []
    supervisor = SimpleNamespace(in_force="the parameters of method random")
    node = SimpleNamespace(
        supervisor=supervisor, switch=switched.append, method=methods.make("random")
    )
    on = main.enable(node, SimpleNamespace(data=True))
    assert on.message == "on, method random: the parameters of method random drive now"
    off = main.enable(node, SimpleNamespace(data=False))
    assert off.message == "off: the parameters of method random drive now"
    assert switched == [True, False]


@pytest.mark.parametrize("is_ending", [False, True])
def test_a_server_that_ends_before_this_node_is_no_warning(monkeypatch, is_ending):
    """A launch file that ends sends SIGINT to both."""
    warnings = []
    monkeypatch.setattr(rospy, "logwarn", warnings.append)
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: is_ending)
    node = SimpleNamespace(trouble="")
    ApplrNode._note_trouble(node, "parameters not changed: /move_base does not answer")
    assert len(warnings) == (not is_ending)
