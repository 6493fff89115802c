"""Tests of nodes started without a ROS master or with invalid arguments, and of nodes interrupted
at once.
"""

import importlib
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from applr_ros1.robots import load
from tests.support import HANGS, ros
from tests.support.refusals import refused

pytest.importorskip("rospy")


def start(*arguments):
    """Start Python without a ROS master at the address that it gets, and return the process."""
    python_paths = [str(ros.ROOT), str(ros.GENERATED), os.environ.get("PYTHONPATH", "")]
    environment = dict(
        os.environ,
        ROS_MASTER_URI="http://localhost:%d" % ros.free_port(),
        PYTHONPATH=os.pathsep.join(python_paths).rstrip(os.pathsep),
    )
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(process, status):
    """Return the output of a command, after checking that it ends with `status`, and in one line if
    it fails.
    """
    output, errors = process.communicate(timeout=HANGS)
    assert process.returncode == status, errors
    # The exit status of an error is 1, and so is the number of its lines.
    assert len(errors.splitlines()) == status, errors
    return output + errors


@pytest.mark.parametrize("name", ["move_base", "send_goal"])
def test_a_node_without_a_master_ends_in_one_line(name):
    error_line = ended(start("-m", "applr_ros1.scripts", name), 1)
    assert error_line.startswith(name + ": no ROS master at http://localhost:")
    assert "roscore" in error_line


@pytest.mark.parametrize("name", ["move_base", "send_goal"])
def test_invalid_arguments_start_nothing(name):
    """Otherwise `send_goal.py 1 0 0` and `send_goal.py --help` would send the robot to the default
    goal.
    """
    # Both at the same time, because each takes seconds to import its libraries.
    with_a_pose = start("-m", "applr_ros1.scripts", name, "1", "0", "0", "_a:=b")
    asked_for_help = start("-m", "applr_ros1.scripts", name, "-h")
    error_line = name + ": unexpected arguments 1 0 0: give parameters as _NAME:=VALUE"
    assert ended(with_a_pose, 1).startswith(error_line)
    assert "~robot" in ended(asked_for_help, 0)


# Program in which the import of pydantic fails, as if it were not installed
WITHOUT_PYDANTIC = """
import sys
sys.modules['pydantic'] = None
from applr_ros1.common.errors import run_script
sys.argv[1:] = ['--help']
run_script('applr_ros1.nodes.move_base.node')
"""


def test_a_missing_python_package_is_one_line_with_the_remedy():
    error_line = ended(start("-c", WITHOUT_PYDANTIC), 1)
    assert "pydantic" in error_line
    assert "./applr packages" in error_line


APPLR = "applr_ros1.nodes.applr.main"
MONITOR = "applr_ros1.nodes.monitor.node"
BRIDGE = "sim_bridge.ros_bridge"


@pytest.mark.parametrize(
    ("module", "own_parameters", "line"),
    [
        (APPLR, "a robot with errors", "controller_frequency"),
        (MONITOR, "a robot with errors", "controller_frequency"),
        (BRIDGE, "a robot with errors", "controller_frequency"),
        (MONITOR, {"more_scans": "rear"}, "give a list of topics"),
        (
            MONITOR,
            {"more_scans": ["front/scan"]},
            "more_scans has front/scan, the first laser's topic",
        ),
        (MONITOR, {"margins": 1}, "unknown parameter margins"),
        (MONITOR, {"deceleration": 0}, "deceleration is 0"),
        (APPLR, {"max_speed": 0.05}, "max_speed is 0.05: give at least 0.2 m/s"),
        # The burger's policies may choose a slower limit, but its planner does not drive straight
        # below min_vel_trans.
        (
            APPLR,
            {"robot": "turtlebot3_burger", "max_speed": 0.1},
            "max_speed is 0.1: give at least 0.11 m/s",
        ),
        (BRIDGE, {"world": "nowhere.world"}, "nowhere.world"),
        (BRIDGE, {"world": "physical_course", "simulator": "gazebo"}, "give pybullet or kinematic"),
    ],
)
def test_invalid_parameters_are_one_line(module, own_parameters, line, tmp_path, monkeypatch):
    if own_parameters == "a robot with errors":
        robot_folder = tmp_path / "mine"
        shutil.copytree(ros.ROOT / "applr_ros1/robots/husky", robot_folder)
        with open(robot_folder / "planner.yaml", "a") as planner_file:
            planner_file.write("\ncontroller_frequency: 0\n")
        own_parameters = {"robot": str(robot_folder)}
    node = importlib.import_module(module)
    monkeypatch.setattr(node, "init_node", lambda name: None)
    # "~" stands for all parameters of the node.
    parameters = {"": own_parameters, **own_parameters}
    monkeypatch.setattr(
        "rospy.get_param", lambda name, *default: parameters.get(name[1:], *default)
    )
    monkeypatch.setattr("rospy.get_name", lambda: "/node")
    monkeypatch.setattr("rospy.resolve_name", lambda name: "/" + name)
    # A node that went on in spite of the error would come to its topics.
    for endpoint in ("Publisher", "Subscriber"):
        monkeypatch.setattr("rospy." + endpoint, lambda *_, **__: pytest.fail("the node goes on"))
    refused(node.main, line)


def test_code_is_imported_only_for_the_method_given_at_the_start(tmp_path, monkeypatch):
    """Any local user, and a website in a browser, can write to the parameter server."""
    node = importlib.import_module("applr_ros1.nodes.applr.main")
    robot = load("jackal")
    own_method = f"{tmp_path}/own.py:Own"
    makes_a_file = f"open('{tmp_path}/ran', 'w')"
    imports_a_method = "from applr_ros1.policy.methods import Method as Own"
    (tmp_path / "own.py").write_text(f"{makes_a_file}\n{imports_a_method}\n")
    made_file = tmp_path / "ran"

    # The method comes from the parameter server alone.
    monkeypatch.setattr(sys, "argv", ["applr.py"])
    monkeypatch.setenv("APPLR_METHOD", "applr")
    method, problem = node.make_method(own_method, robot, node.started_with(own_method))
    assert method.name == "dwa"
    assert not made_file.exists()
    assert "start the node with _method:=" in problem

    # It is given on the command line.
    sys.argv.append("_method:=" + own_method)
    method, _ = node.make_method(own_method, robot, node.started_with(own_method))
    assert method.name == own_method
    assert made_file.exists()

    # It is given by a launch file, in the environment.
    monkeypatch.setattr(sys, "argv", ["applr.py"])
    monkeypatch.setenv("APPLR_METHOD", own_method)
    method, _ = node.make_method(own_method, robot, node.started_with(own_method))
    assert method.name == own_method


# Program that reports the beginning of the import of training.train
TRAIN = """
import sys
from applr_ros1.common.errors import run_script

class Begun:
    def find_spec(self, name, *more):
        if name == 'training':
            print('begun', flush=True)

sys.meta_path.insert(0, Begun())
sys.argv[1:] = ['--help']
run_script('training.train')
"""


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_ctrl_c_during_the_import(delay):
    process = start("-c", TRAIN)
    assert process.stdout.readline() == "begun\n"
    # At once, or while the libraries of training are imported
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=HANGS)
    assert "Traceback" not in errors, errors
    assert len(errors.splitlines()) <= 1, errors


# Node whose main thread holds a lock that its shutdown needs
NODE = """
import threading, time, rospy
from applr_ros1.common import ros_node
ros_node.init_node("node")
lock = threading.Lock()
rospy.on_shutdown(lock.acquire)
with lock:
    print("ready", flush=True)
    while not rospy.core.is_shutdown_requested():
        time.sleep(0.01)
"""


def test_shutdown_waits_for_a_lock_of_the_main_thread():
    with ros.RosMaster() as master:
        child = master.spawn(sys.executable, "-c", NODE)
        child.until("ready")
        os.kill(child.pid, signal.SIGINT)
        assert child.process.wait(HANGS) == 0, child.text
