"""Arguments of the launch files, and errors of nodes and demo about invalid arguments."""

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import threading
from types import SimpleNamespace

import pytest
import roslaunch.config
import roslaunch.core
import roslaunch.loader
import roslaunch.xmlloader

from applr_ros1.common import arguments
from applr_ros1.common.errors import run_main
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.nodes.tools import demo, launcher, play, send_goal
from applr_ros1.nodes.viewer import admission
from applr_ros1.planner.parameters.check import check, complete
from applr_ros1.policy import methods
from tests.support import HANGS, ROOT
from tests.support.refusals import refused

pytestmark = pytest.mark.ros
REAL_ROBOT = ("sim:=false", "robot:=jackal", "max_speed:=0")
LAUNCH = os.path.join(ROOT, "applr_ros1", "launch")
JACKAL_FOLDER = os.path.join(ROOT, "applr_ros1", "robots", "jackal")


@pytest.fixture(autouse=True, scope="module")
def each_command_once():
    """Cache the output of the command with which launch files read a robot, because many tests need
    it.
    """
    # It starts Python and reads the robot's folder each time.
    load_value = roslaunch.loader.Loader.param_value
    outputs = {}

    def param_value(self, verbose, name, kind, value, textfile, binfile, command):
        """Return the value of a parameter: that of `command`, if it is not None."""
        arguments = (verbose, name, kind, value, textfile, binfile, command)
        if command is None:
            return load_value(self, *arguments)
        if command not in outputs:
            outputs[command] = load_value(self, *arguments)
        return outputs[command]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roslaunch.loader.Loader, "param_value", param_value)
        yield


def loaded(file, *words):
    """Load a launch file with roslaunch, without starting it."""
    config = roslaunch.config.ROSLaunchConfig()
    loader = roslaunch.xmlloader.XmlLoader()
    loader.ignore_unset_args = False
    loader.load(os.path.join(LAUNCH, file), config, argv=list(words), verbose=False)
    environment = {}
    node_words = {}
    for node in config.nodes:
        environment[node.name] = dict(node.env_args)
        node_words[node.name] = shlex.split(node.args or "")
    return SimpleNamespace(
        config=config,
        cleared=[namespace.rstrip("/") + "/" for namespace in config.clear_params],
        parameters={name: parameter.value for name, parameter in config.params.items()},
        environment=environment,
        words=node_words,
    )


def test_parameter_files_are_the_jackals():
    # What the launch file sets itself: everything else comes from the robot's folder.
    of_move_base = {}
    for full_name, launched_value in loaded("jackal_applr.launch").parameters.items():
        if full_name.startswith("/move_base/"):
            of_move_base[full_name[len("/move_base/") :]] = launched_value
    common = {"robot": "jackal", "map": False, "tf_prefix": "none"}
    assert of_move_base == {
        **common,
        "method": "auto",
        "matched": True,
        "TrajectoryPlannerROS/meter_scoring": False,
        "applr/max_speed": 0.0,
        "applr/movers": True,
    }

    # With these, the node takes the Jackal's files.
    launched = dict(common, TrajectoryPlannerROS={"meter_scoring": False}, applr={"max_speed": 0.0})
    parameters, robot = with_robot(launched)
    assert robot.name == "jackal"
    assert check(parameters) == []
    del parameters["applr"]  # the C++ move_base has no such parameters
    planner_parameters = parameters["TrajectoryPlannerROS"]
    of_files = dict(robot.parameters(), TrajectoryPlannerROS=planner_parameters)
    assert complete(parameters) == complete(of_files)


@pytest.mark.parametrize(
    ("words", "nodes"),
    [
        (
            (*REAL_ROBOT, "monitor:=false", "movers:=false", "black_box:=false"),
            {"move_base", "applr"},
        ),
        (
            (*REAL_ROBOT, "move_base:=cpp", "goal:=4 0 0"),
            {"collision_monitor", "movers", "applr", "black_box", "send_goal"},
        ),
        (
            ("record:=/tmp/a.bag", "rviz:=true", "goal:=none", "black_box:=false"),
            {"sim_bridge", "move_base", "collision_monitor", "movers", "applr", "record", "rviz"},
        ),
    ],
)
def test_arguments_select_the_nodes_that_start(words, nodes):
    assert set(loaded("jackal_applr.launch", *words).words) == nodes


def test_the_black_box_gets_what_the_launch_files_know():
    words = ("robot:=turtlebot3_burger", "map:=true")
    with_stack = loaded("jackal_applr.launch", *words).parameters
    assert with_stack["/black_box/robot"] == "turtlebot3_burger"
    assert with_stack["/black_box/map"] is True
    assert with_stack["/black_box/move_base"] == "move_base"
    # A simulated stop is no stop of the robot, whose folder is the node's default.
    assert with_stack["/black_box/folder"] == "~/.ros/black_box_simulated"
    assert "/black_box/folder" not in loaded("jackal_applr.launch", *REAL_ROBOT).parameters
    # Alone, it finds everything, whatever robot it is.
    alone = loaded("black_box.launch", "folder:=/tmp/stops", "minutes:=5").parameters
    assert alone["/black_box/robot"] == "none"
    assert alone["/black_box/minutes"] == 5.0
    assert alone["/black_box/folder"] == "/tmp/stops"
    for parameter_name in ("move_base", "scan_topic", "odom_topic", "cmd_vel_topic"):
        assert alone[f"/black_box/{parameter_name}"] == "auto"


METER_SCORING = "move_base/TrajectoryPlannerROS/meter_scoring"
TRAJECTORIES = "move_base/DWAPlannerROS/publish_traj_pc"
# Words of the command line, and parameters that the nodes get (None: it is not set)
REACHED = {
    "": {
        "use_sim_time": True,
        # Without a seed the simulator repeats its noise, but the node draws a seed of its own.
        "sim_bridge/seed": 0,
        "applr/seed": "auto",
        "applr/method": "auto",
        "applr/meter_scoring": "auto",
        METER_SCORING: False,
        TRAJECTORIES: None,
        "move_base/applr/movers": True,
        "collision_monitor/escape": False,
    },
    # On a robot without its own simulator, Gazebo sets the clock, or nobody.
    "sim:=false robot:=jackal max_speed:=0": {"use_sim_time": None},
    "sim:=false robot:=jackal max_speed:=0 use_sim_time:=true": {"use_sim_time": True},
    "max_speed:=0.3": {"applr/max_speed": 0.3, "move_base/applr/max_speed": 0.3},
    "tf_prefix:=a": {"collision_monitor/tf_prefix": "a", "move_base/tf_prefix": "a"},
    # Plans are in the frame of matched poses only if the monitor runs.
    "monitor:=false": {"move_base/matched": False},
    "seed:=3": {"applr/seed": 3, "sim_bridge/seed": 3},
    "method:=/own.py:Own": {"applr/method": "/own.py:Own"},
    "meter_scoring:=true": {"applr/meter_scoring": "true", METER_SCORING: True},
    "movers:=false": {"move_base/applr/movers": False},
    # The C++ move_base has no such parameter, and makes no escape motions itself.
    "move_base:=cpp": {"move_base/applr/movers": None, "collision_monitor/escape": True},
    # The page draws the trajectories.
    "viewer:=true": {TRAJECTORIES: True},
}


@pytest.mark.parametrize("words", REACHED)
def test_an_argument_reaches_its_nodes(words):
    parameters = loaded("jackal_applr.launch", *words.split()).parameters
    assert {name: parameters.get("/" + name) for name in REACHED[words]} == REACHED[words]


def test_topics_and_the_code_of_a_method_reach_the_nodes():
    words = ("scan_topic:=/lidar/scan", "method:=/own.py:Own")
    launched = loaded("jackal_applr.launch", *words)
    assert all(["front/scan", "/lidar/scan"] in node.remap_args for node in launched.config.nodes)
    # The code of a method comes in the environment, which no other user can write to.
    assert launched.environment["applr"] == {"APPLR_METHOD": "/own.py:Own"}


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        (("sim:=false",), "robot"),
        (("sim:=false", "robt:=husky", "max_speed:=0.4"), "robot"),
        (("sim:=false", "robot:=jackal", "max_sped:=0.4"), "max_speed"),
    ],
)
def test_a_real_robot_needs_its_name_and_a_speed_limit(words, missing):
    """roslaunch ignores misspelt arguments: the robot would drive at full speed."""
    with pytest.raises(roslaunch.core.RLException, match=f"requires the '{missing}' arg"):
        loaded("jackal_applr.launch", *words)
    assert loaded("jackal_applr.launch", "sim:=false", "robot:=jackal", "max_speed:=0.4")


@pytest.mark.fault("23a")
def test_paths_with_spaces_reach_the_nodes_as_they_are(tmp_path):
    robot_folder = str(tmp_path / "my robot")
    bag_path = str(tmp_path / "a drive.bag")
    shutil.copytree(JACKAL_FOLDER, robot_folder)
    launched = loaded(
        "jackal_applr.launch",
        "robot:=" + robot_folder,
        "record:=" + bag_path,
        "rviz:=true",
        "world:=/a b.world",
    )
    for node in ("sim_bridge", "move_base", "collision_monitor", "movers", "applr", "send_goal"):
        assert launched.parameters["/%s/robot" % node] == robot_folder
    assert launched.parameters["/sim_bridge/world"] == "/a b.world"
    assert launched.parameters["/send_goal/world"] == "/a b.world"
    assert launched.words["record"][2:4] == ["-O", bag_path]
    assert launched.parameters["/send_goal/recorder"] == "record"
    assert launched.words["record"][5] == launched.parameters["/record/unrecorded"]
    assert launched.words["rviz"][1].endswith("/applr_ros1/applr_ros1/rviz/applr.rviz")
    replayed = loaded("replay.launch", "bag:=" + bag_path, "robot:=" + robot_folder)
    assert replayed.words["player"][-1] == bag_path


def test_launch_files_clear_the_parameters_of_an_earlier_launch():
    for launch_file, words in (
        ("jackal_applr.launch", ("rviz:=true",)),
        ("barn_controller.launch", ()),
        ("black_box.launch", ()),
        ("../../compat/jackal_helper/launch/gazebo_launch.launch", ()),
        ("../../compat/jackal_helper/launch/move_base_DWA.launch", ()),
    ):
        launched = loaded(launch_file, *words)
        # Parameters of nodes: roslaunch sets some of its own.
        of_nodes = [name for name in launched.parameters if re.match(r"/(?!roslaunch)\w+/", name)]
        assert of_nodes
        for parameter_name in of_nodes:
            is_cleared = parameter_name.startswith(tuple(launched.cleared))
            assert is_cleared, f"{launch_file}: {parameter_name}"
        # Parameters outside of nodes are set after the clearing.
        if launch_file.startswith("barn"):
            assert launched.parameters["/move_base/global_costmap/width"] == 60


@pytest.mark.fault("23a")
@pytest.mark.parametrize(
    ("command", "words", "line"),
    [
        (
            demo,
            ["wrold:=generated:7"],
            "wrold:=generated:7 is not an argument: give ARG:=VALUE with one of sim, r",
        ),
        (demo, ["world:=generated:300"], "generated:300"),
        (demo, ["method:=faster"], "method 'faster' is unknown"),
        (demo, ["goal:=1 2"], "goal is 1 2: give three numbers 'x y yaw'"),
        (demo, ["goal:=none"], "the demo needs sim:=true"),
        (demo, ["limit:=long"], "limit is 'long': give a number from 1 to 3600"),
        (
            demo,
            ["page:=/no/such/folder/a.html"],
            "give a .html file in a folder that can be written",
        ),
        (demo, ["map:=maybe"], "map is maybe: give true or false"),
        (demo, ["black_box:=2"], "black_box is 2: give true or false"),
        (demo, ["max_speed:=fast"], "max_speed is 'fast': give a number"),
        (demo, ["max_speed:=-1"], "max_speed is -1"),
        (demo, ["simulator:=gazeboo"], "simulator 'gazeboo' is unknown: give pybullet or kin"),
        (demo, ["map:=true"], "has no move_base.with_map: give its files for a map"),
        (
            demo,
            ["record:=/no/such/folder/a.bag"],
            "record is /no/such/folder/a.bag: give a .bag file in a folder that can be written",
        ),
        (play, ["robot:=foo"], "robot foo: give"),
        (play, ["rviz:=maybe"], "rviz is maybe: give true or false"),
    ],
)
def test_a_wrong_argument_is_one_line_before_anything_starts(
    command, words, line, capsys, monkeypatch
):
    monkeypatch.setattr(command, "private_nodes", lambda *_: pytest.fail("it starts"))
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("sys.argv", ["command", *words])
    assert run_main(command.main, "it") == 1
    assert re.fullmatch(f"it: .*{line}.*\n", capsys.readouterr().err)


def test_the_demo_passes_files_on_with_absolute_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(os.path.join(ROOT, "applr_ros1", "robots", "jackal", "static.json"), "set.json")
    words = ["method:=set.json", "record:=a.bag", "goal:=1 0 0", "limit:=9"]
    assert demo.prepare(words).passed == {
        "method": f"{tmp_path}/set.json",
        "record": f"{tmp_path}/a.bag",
        "goal": "none",
        "seed": 0,
    }


def test_files_of_a_method_get_absolute_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").touch()
    for method_spec, absolute_spec in (
        ("applr", "applr"),
        ("mine.safetensors", "{0}/mine.safetensors"),
        ("set.json", "{0}/set.json"),
        ("own.py:Own", "{0}/own.py:Own"),
        ("own:Own", "{0}/own.py:Own"),
        ("json:Own", "json:Own"),
        ("package.own:Own", "package.own:Own"),
    ):
        absolute = methods.absolute(method_spec)
        assert absolute == absolute_spec.format(tmp_path)
        # An absolute one stays.
        assert methods.absolute(absolute) == absolute


def test_the_demos_master_listens_on_loopback_only(monkeypatch):
    from rosgraph.network import get_bind_address

    for variable in ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_LOG_DIR", "ROS_NAMESPACE"):
        monkeypatch.setenv(variable, "")  # so that monkeypatch restores it
    monkeypatch.setenv("ROS_IP", "192.0.2.1")
    stack = SimpleNamespace(wait=lambda *_: None, show_errors=lambda: None, stop=lambda: None)
    monkeypatch.setattr(launcher, "LaunchedNodes", lambda *_: stack)
    with launcher.private_nodes({}):
        assert get_bind_address() == "127.0.0.1"


def test_play_takes_nothing_but_the_port_from_the_parameter_server(monkeypatch):
    """Any local user, and any website in a browser, can write to the parameter server."""
    opened_pages = []
    waited_for = []

    class Stack:
        """Nodes of which nothing runs: others write to the parameter server meanwhile."""

        def wait(self, part, condition, *_, **__):
            """Check the condition for the page: with a foreign address, and with ours."""
            waited_for.append(part)
            if part == "the page":
                assert not condition()
                parameter_server["/viewer/address"] = (
                    f"http://127.0.0.1:8081/{os.environ[admission.TOKEN]}/"
                )
                assert condition()
                parameter_server["/viewer/address"] = "http://evil.example/"

        def check(self):
            """End the program, as Ctrl-C does."""
            raise KeyboardInterrupt

    parameter_server = {"/viewer/address": "file:///etc/passwd"}
    monkeypatch.setenv(admission.TOKEN, "secret")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(play.rospy, "get_param", lambda name, default=None: parameter_server[name])
    monkeypatch.setattr(play, "private_nodes", lambda given: contextlib.nullcontext(Stack()))
    monkeypatch.setattr(play.webbrowser, "open", opened_pages.append)
    monkeypatch.setattr("sys.argv", ["play.py"])
    with pytest.raises(KeyboardInterrupt):
        play.main()
    assert opened_pages == ["http://127.0.0.1:8081/secret/"]
    assert waited_for == ["the page", "move_base"]


def test_the_demo_ends_when_a_node_has_died(monkeypatch):
    # Lines of roslaunch, some of them in colour. A window that is closed ends nothing.
    applr_dies = [
        "[rviz-7] process has finished cleanly\n",
        "\x1b[31m[applr-5] process has died [pid 1, exit code 1, cmd\n",
    ]
    move_base_dies = ["REQUIRED process [move_base-3] has died!\n"]
    for printed_lines, problem in (
        (applr_dies, "applr has died"),
        (move_base_dies, "move_base has"),
    ):
        process = SimpleNamespace(stderr=printed_lines, poll=lambda: None)
        monkeypatch.setattr(launcher.subprocess, "Popen", lambda *_, process=process, **__: process)
        stack = launcher.LaunchedNodes({}, 11311, "/tmp")
        refused(lambda stack=stack: stack.wait("applr", lambda: False), "^" + problem)


@pytest.mark.parametrize("hangs", [False, True])
def test_a_roslaunch_that_does_not_end_is_killed(hangs, monkeypatch, capfd):
    signals = []

    def wait(timeout=None):
        if hangs and "kill" not in signals:
            assert timeout is not None, "it would wait forever"
            raise subprocess.TimeoutExpired("roslaunch", timeout)

    process = SimpleNamespace(
        stderr=[],
        poll=lambda: None,
        send_signal=signals.append,
        kill=lambda: signals.append("kill"),
        wait=wait,
    )
    monkeypatch.setattr(launcher.subprocess, "Popen", lambda *_, **__: process)
    monkeypatch.setattr(launcher.rospy, "signal_shutdown", lambda _: None)
    launcher.LaunchedNodes({}, 11311, "/tmp").stop()
    assert signals == [signal.SIGINT, *(["kill"] if hangs else [])]
    assert ("did not end within 60 s" in capfd.readouterr().out) == hangs


def test_a_master_that_does_not_start_is_one_line(monkeypatch, capfd):
    no_master = [
        "--- Logging error ---\n",
        "Traceback (most recent call last):\n",
        "\x1b[31mRLException: ERROR: could not contact master [http://localhost:1/]\x1b[0m\n",
    ]
    wrong_value = ["\x1b[31mRLException: sim is perhaps\x1b[0m\n"]
    for printed_lines, problem, shown in (
        (no_master, "the ROS master did not start within 10 s", ""),
        (wrong_value, "the stack has ended unexpectedly", "".join(wrong_value)),
    ):
        process = SimpleNamespace(stderr=printed_lines, poll=lambda: 1)
        monkeypatch.setattr(launcher.subprocess, "Popen", lambda *_, process=process, **__: process)
        stack = launcher.LaunchedNodes({}, 11311, "/tmp")
        refused(lambda stack=stack: stack.wait("the ROS master", lambda: False), "^" + problem)
        assert capfd.readouterr().err == shown


def test_errors_of_the_nodes_are_shown_from_the_start_of_the_master_on(monkeypatch, capfd):
    """Nothing that was printed before is lost."""
    has_started = threading.Event()
    is_shown = threading.Event()

    def lines():
        yield "first\n"
        has_started.wait()
        yield "second\n"
        is_shown.set()

    process = SimpleNamespace(stderr=lines(), poll=lambda: None)
    monkeypatch.setattr(launcher.subprocess, "Popen", lambda *_, **__: process)
    stack = launcher.LaunchedNodes({}, 11311, "/tmp")
    assert capfd.readouterr().err == ""
    stack.show_errors()
    has_started.set()
    assert is_shown.wait(HANGS)
    # Each error is printed once, also if the stack ends later.
    stack.show_errors()
    assert capfd.readouterr().err == "first\nsecond\n"


@pytest.mark.parametrize(
    ("argument", "prefix"),
    [("", ""), ("none", ""), ("robot1", "robot1/"), ("/robot1/", "robot1/")],
)
def test_a_frame_prefix_ends_with_a_slash(argument, prefix):
    assert arguments.frame_prefix(argument) == prefix


def test_no_goal_is_sent_if_the_goal_is_none(monkeypatch):
    monkeypatch.setattr(
        send_goal.actionlib, "SimpleActionClient", lambda *_: pytest.fail("a goal is sent")
    )
    monkeypatch.setattr(send_goal, "init_node", lambda name: None)
    monkeypatch.setattr(send_goal.rospy, "get_param", lambda name, default: {"goal": "none"})
    send_goal.main()
