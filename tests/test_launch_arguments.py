"""Arguments of the launch file that are refused before anything starts, and what nodes and demo make of the others."""

import json
import os
import re
import shutil
import sys

import pytest
from test_launch import ROOT, inside
from test_launch_paths import LOAD

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes import arguments, demo, mode_files, recording
from applr_ros1.robots import NAMES, load

pytestmark = pytest.mark.ros
LAUNCH = os.path.join(ROOT, "applr_ros1", "launch")
JACKAL = os.path.join(ROOT, "applr_ros1", "robots", "jackal")
SET = os.path.join(ROOT, "applr_ros1", "models", "static.json")
POLICY = os.path.join(ROOT, "applr_ros1", "models", "applr_start.safetensors")
OWN_NAMES = "topics: {scan: laser/scan, odometry: base/odom, cmd_vel: base/cmd_vel, imu: imu/data}"


def refusal(**given):
    """The line with which the check refuses arguments, "" where it takes them."""
    values = {name: default for name, (default, _) in arguments.declared().items()}
    try:
        arguments.check(dict(values, **given))
    except ApplrError as error:
        return str(error)
    return ""


def described(folder, pattern, replacement):
    """The folder of a description that is the Jackal's with another line or without one."""
    shutil.copytree(JACKAL, folder)
    text, count = re.subn(pattern, replacement, (folder / "robot.yaml").read_text(), flags=re.MULTILINE)
    assert count == 1
    (folder / "robot.yaml").write_text(text)
    return str(folder)


@pytest.mark.parametrize("number", ["5.0", "1e3", "-1", "2147483648", "", "५"])
def test_a_seed_is_written_in_digits(number):
    assert refusal(seed=number) == "seed is %s: give a whole number from 0 to 2147483647" % (number or "empty")
    assert refusal(seed="2147483647") == ""


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (dict(parameters=SET), "parameters is %s: mode applr does not use it; give mode:=fixed, or" % SET),
        (dict(parameters="no.json"), "parameters is no.json: mode applr does not use it; give mode:=fixed, or"),
        (dict(policy=POLICY, mode="dwa"), "mode dwa does not use it; give mode:=applr or mode:=appld, or"),
        (dict(policy=POLICY, mode="applr:" + POLICY), "does not use it"),
    ],
)
def test_a_file_that_the_mode_does_not_use_is_refused(given, line):
    assert line in refusal(**given)
    assert refusal(mode="fixed", parameters=SET) == refusal(policy=POLICY) == ""


def test_a_bag_that_is_there_is_not_written_over(tmp_path, monkeypatch):
    bag = tmp_path / "a.bag"
    assert refusal(record=str(bag)) == ""
    bag.with_suffix(".bag.active").touch()
    assert refusal(record=str(bag)) == "record is %s: %s.active is there already; give another name" % (bag, bag)
    bag.write_text("a drive")
    line = "record is %s: it is there already; give another name" % bag
    assert refusal(record=str(bag)) == line
    monkeypatch.setattr(recording, "become", lambda *_: pytest.fail("rosbag starts"))
    with pytest.raises(arguments.ArgumentError, match="already"):
        recording._record([str(bag)])


def test_topics_of_a_robot_with_other_names_are_changed_in_its_description(tmp_path):
    robot = described(tmp_path / "crate", r"^topics: .*$", OWN_NAMES)
    for name, own, field in (("scan", "laser/scan", "scan"), ("odom", "base/odom", "odometry")):
        line = "%s_topic is new: robot crate has %s; change topics.%s in its robot.yaml instead" % (name, own, field)
        assert refusal(robot=robot, **{name + "_topic": "new"}) == line
        assert refusal(robot=robot, **{name + "_topic": own}) == refusal(**{name + "_topic": "new"}) == ""
    assert "cmd_vel_topic is new: robot crate has base/cmd_vel" in refusal(robot=robot, cmd_vel_topic="new")
    line = "monitor is false: move_base commands cmd_vel, robot crate base/cmd_vel; add cmd_vel_topic:=base/cmd_vel"
    assert refusal(robot=robot, monitor="false") == line
    assert refusal(robot=robot, monitor="false", cmd_vel_topic="base/cmd_vel") == ""
    assert refusal(robot=robot, monitor="false", move_base="cpp") == refusal(monitor="false") == ""


def test_names_that_the_launch_file_replaces_are_those_that_the_check_knows():
    with open(os.path.join(LAUNCH, "jackal_applr.launch"), encoding="utf-8") as file:
        replaced = re.findall(r'^  <remap from="(\S+)" to="\$\(arg (\w+)\)"', file.read(), re.MULTILINE)
    known = {(name, topic) for topic, (_, names) in arguments.REPLACED.items() for name in names}
    assert set(replaced) == known


def test_a_cap_on_the_speed_needs_a_parameter_for_it(tmp_path):
    robot = described(tmp_path / "crate", r"^  max_vel_x: .*\n", "")
    line = "max_speed is 0.4: robot crate has no parameter max_vel_x to cap; give none"
    assert refusal(robot=robot, max_speed="0.4", mode="dwa") == line
    assert refusal(robot=robot, mode="dwa") == refusal(max_speed="0.4") == ""


def test_files_for_a_map_are_needed_where_our_move_base_is_started():
    assert "robot.yaml has no move_base.with_map" in refusal(map="true")
    assert refusal(map="true", move_base="cpp", sim="false") == ""


@pytest.mark.parametrize(
    ("mode", "becomes"),
    [
        ("applr", "applr"),
        ("appld:published", "appld:published"),
        ("mine.safetensors", "%s/mine.safetensors"),
        ("set.json", "%s/set.json"),
        ("fixed:set.json", "fixed:%s/set.json"),
        ("appld:mine.safetensors", "appld:%s/mine.safetensors"),
        ("frozen:vx_samples:mine.safetensors", "frozen:vx_samples:%s/mine.safetensors"),
        ("frozen:vx_samples:applr", "frozen:vx_samples:applr"),
        ("period:1:own.py:Own", "period:1:%s/own.py:Own"),
        ("own.py:Needs:weights.txt", "%s/own.py:Needs:{0}/weights.txt"),
        ("own.py:Needs:applr", "%s/own.py:Needs:applr"),  # a word, though a file has this name
        ("own.py:Needs:0.5", "%s/own.py:Needs:0.5"),
        ("own:Own", "%s/own.py:Own"),
        ("json:Own", "json:Own"),
        ("/a/own.py:Own", "/a/own.py:Own"),
        ("faster", "faster"),
    ],
)
def test_files_of_a_mode_get_their_folder(mode, becomes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    entries = [entry for entry in sys.path if entry]  # as a script has them; to make a method adds the folder
    monkeypatch.setattr("sys.path", [*entries, str(tmp_path)])
    for name in ("own.py", "json.py", "weights.txt", "applr"):
        (tmp_path / name).touch()
    expected = becomes.replace("%s", str(tmp_path)).replace("{0}", str(tmp_path))
    assert mode_files.absolute(mode) == expected
    assert mode_files.absolute(expected) == expected


def test_a_module_that_the_nodes_find_stays_a_module(tmp_path, monkeypatch):
    """Its file by itself would be in no package."""
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "own.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path, str(tmp_path)])
    assert mode_files.absolute("package.own:Own") == "%s/package/own.py:Own" % tmp_path
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert mode_files.absolute("package.own:Own") == "package.own:Own"


def test_a_start_is_read_alike_by_the_check_and_the_simulator():
    from sim_bridge import ros_bridge

    for text in ("-3.0,1.2,1.57", "-3 1.2 1.57"):
        assert refusal(start=text) == ""
        assert ros_bridge._start(text) == arguments.pose("start", text) == (-3.0, 1.2, 1.57)


def test_a_simulator_of_ones_own_is_looked_at_before_anything_starts(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("from sim_bridge.kinematic_simulator import KinematicSimulator as Mine\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", sys.path[:])
    assert refusal(simulator="mine.py:Mine") == ""
    assert refusal(simulator="mine:Mine").endswith("its node runs in another folder; give mine.py:Mine")
    assert "cannot be imported" in refusal(simulator="mine.py:Yours")


def test_the_demo_hands_the_mode_on_with_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    started, environments = [], [os.environ]

    def start(command, environment, _):
        started.extend(command)
        environments.append(environment)

    monkeypatch.setattr(demo.processes, "start", start)
    for name in ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE"):
        monkeypatch.setenv(name, "")
    values = {name: default for name, (default, _) in arguments.declared().items()}
    demo.Stack(dict(values, mode="fixed:set.json", port="1", given={}), None)
    assert "mode:=fixed:%s/set.json" % tmp_path in started
    for environment in environments:  # of the nodes, and of the demo itself
        assert not {"ROS_IP", "ROS_NAMESPACE"} & set(environment)
        assert environment["ROS_MASTER_URI"] == "http://localhost:1"


def test_the_demo_makes_its_own_clock(capsys):
    assert demo.main(["clock:=false"]) == 2
    assert "clock is false: on the demo's own master nobody else makes the clock" in capsys.readouterr().err
    assert demo.main(["port:=1e4"]) == 2
    assert "port is 1e4: give a whole number from 1024 to 65535" in capsys.readouterr().err


def test_the_demo_ends_when_a_node_that_is_started_again_has_failed(tmp_path):
    stack = demo.Stack.__new__(demo.Stack)
    stack.check = lambda: None
    with open(tmp_path / "log", "w", encoding="utf-8") as stack.log:
        stack.log.write("[INFO] [12.3]: sim_bridge: ready\n")
        stack.log.flush()
        stack.check_nodes()
        stack.log.write("applr: method own.py:Own cannot be made\n")
        stack.log.write("\x1b[31m[applr-5] process has died [pid 7, exit code 1, cmd applr.py].\x1b[0m\n")
        stack.log.flush()
        with pytest.raises(demo.DemoError, match="a node ended by itself: applr: method own.py:Own cannot be made"):
            demo.Waiting(stack).until(lambda: False, 20.0, "applr does not come up")


def test_launch_files_know_the_robots_and_clear_what_an_earlier_launch_left():
    for name in ("jackal_applr.launch", "replay.launch"):
        with open(os.path.join(LAUNCH, name), encoding="utf-8") as file:
            listed = re.findall(r"arg\('robot'\) in \((.*?)\)", file.read())
        assert [set(re.findall(r"'(\w+)'", names)) for names in listed] == [set(NAMES)]
    code = LOAD.replace("print(json.dumps({\n", 'print(json.dumps({\n    "cleared": config.clear_params,\n')
    cleared = {}
    for name, words in (
        ("jackal_applr.launch", ("rviz:=true",)),
        ("barn_controller.launch", ()),
        ("velocity_method.launch", ("method:=a:B",)),
        ("../../compat/jackal_helper/launch/gazebo_launch.launch", ()),
        ("../../compat/jackal_helper/launch/move_base_DWA.launch", ()),
    ):
        done = inside("python", "-c", code, os.path.join(LAUNCH, name), *words)
        assert done.returncode == 0, done.stderr[-2000:]
        found = json.loads(done.stdout.splitlines()[-1])
        cleared[name] = {entry.strip("/") for entry in found["cleared"]}
        with_parameters = {entry.split("/")[1] for entry in found["parameters"]}
        assert cleared[name] >= with_parameters - {"use_sim_time", "robot_description", "run_id", "roslaunch"}
        if name.startswith("barn"):  # what it sets itself is set after that
            assert found["parameters"]["/move_base/global_costmap/width"] == 60
            assert found["parameters"]["/applr/mode"] == "applr"
    assert {"sim_bridge", "move_base", "collision_monitor", "applr", "send_goal", "parameter_panel"} <= cleared[
        "jackal_applr.launch"
    ]


@pytest.mark.parametrize(
    ("given", "frame"),
    [({}, "odom_combined"), ({"tf_prefix": "robot1"}, "robot1/odom_combined"), ({"frame": "here"}, "here")],
)
def test_a_goal_is_sent_in_the_frame_of_the_robots_odometry(given, frame, tmp_path, monkeypatch):
    from applr_ros1.nodes import goal

    sent, said = [], []

    class Client:
        def __init__(self, *_):
            pass

        wait_for_server = wait_for_result = get_state = get_goal_status_text = lambda self: None

        def send_goal(self, message):
            sent.append(message.target_pose.header.frame_id)

    given["robot"] = described(tmp_path / "crate", r"odom: odom\}", "odom: odom_combined}")
    assert load(given["robot"]).frames.odom == "odom_combined"
    monkeypatch.setattr(goal, "require_master", lambda: None)
    monkeypatch.setattr(goal.actionlib, "SimpleActionClient", Client)
    for name, stand_in in (
        ("init_node", lambda name: None),
        ("get_param", lambda name, default: dict(given, goal="1 2 0").get(name.strip("~"), default)),
        ("get_time", lambda: 1.0),
        ("is_shutdown", lambda: False),
        ("loginfo", lambda text, *words: said.append(text % words)),
    ):
        monkeypatch.setattr(goal.rospy, name, stand_in)
    assert goal.main() == 0
    assert sent == [frame]
    assert "rad in %s" % frame in said[0]


def test_a_simulated_robot_needs_its_own_time():
    assert refusal(use_sim_time="false").startswith("use_sim_time is false: a simulated robot's time is that of /clock")
    assert refusal(use_sim_time="true") == refusal(sim="false", use_sim_time="false") == ""


def test_no_goal_is_sent_where_none_is_asked_for(monkeypatch):
    from applr_ros1.nodes import goal

    said = []
    monkeypatch.setattr(goal, "require_master", lambda: None)
    monkeypatch.setattr(goal.actionlib, "SimpleActionClient", lambda *_: pytest.fail("a goal is sent"))
    monkeypatch.setattr(goal.rospy, "init_node", lambda name: None)
    monkeypatch.setattr(goal.rospy, "get_param", lambda name, default: "none" if name == "~goal" else default)
    monkeypatch.setattr(goal.rospy, "loginfo", said.append)
    assert goal.main() == 0
    assert said == ["goal is none: nothing is sent"]
