"""Tests of the launch file, the parameter files, the catkin package in devel and install space, and
./applr demo.
"""

import contextlib
import json
import math
import os
import re
import shutil
import signal
import subprocess
import time
from unittest.mock import create_autospec

import actionlib
import numpy as np
import psutil
import pytest
import yaml
from actionlib_msgs.msg import GoalStatus

import worlds
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import REACHED, Goal
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED, TOO_EARLY
from applr_ros1.nodes.conversions import Reading
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.nodes.tools import demo as demo_tool
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.robots import JACKAL, NAMES, load
from tests.support import DATA, HANGS, ROOT, is_alive
from tests.support.drives import driven
from tests.support.pages import data_of
from tests.support.ros import Kept, wait_for

APPLR = os.path.join(ROOT, "applr")
pytestmark = pytest.mark.ros


def inside(*command):
    """Run a command in the workspace's environment and return its finished process."""
    return subprocess.run(
        [APPLR, "exec", *command], capture_output=True, text=True, timeout=HANGS, check=False
    )


# The Jackal has no files for a map.
@pytest.mark.parametrize("name", [name for name in NAMES if name != "jackal"])
def test_other_robots_bring_their_files_names_and_frames(name):
    """The launch file also applies a frame prefix, and a parameter value that overrides the
    files.
    """
    robot = load(name)
    overriding_value = {"local_costmap": {"publish_frequency": 1.5}}
    parameters, _ = with_robot(dict(overriding_value, robot=name, map=True, tf_prefix="robot1"))
    assert check(parameters) == []
    all_parameters = complete(parameters)
    global_costmap = all_parameters["global_costmap"]
    local_costmap = all_parameters["local_costmap"]
    assert global_costmap["global_frame"] == "map"
    assert local_costmap["global_frame"] == "robot1/" + robot.frames.odom
    base_frame = "robot1/" + robot.frames.base
    assert global_costmap["robot_base_frame"] == local_costmap["robot_base_frame"] == base_frame
    assert local_costmap["publish_frequency"] == 1.5
    assert MoveBase(parameters).missing_map.lstrip("/") == "map"

    without_map, _ = with_robot({"robot": name})
    move_base = MoveBase(without_map)
    assert (move_base.missing_map, list(move_base.sources)) == ("", [robot.topics.scan])
    assert complete(without_map)["global_costmap"]["global_frame"] == robot.frames.odom


def test_move_base_starts_with_the_range_for_which_its_method_was_made(tmp_path):
    folder = shutil.copytree(load("jackal").folder, tmp_path / "mine")
    (folder / "applr.safetensors").unlink()
    (folder / "static.json").write_text('{"obstacle_range": 5.0, "parameters": {}}')

    def range_with(**method):
        """Return the obstacle range with which the node starts its costmaps [m]."""
        parameters, _ = with_robot({"robot": str(folder), **method})
        (global_range, local_range) = (
            source.obstacle_range for source in laser_sources(parameters)
        )
        assert global_range == local_range
        return global_range

    assert range_with(method="static") == 5.0
    assert range_with(method="auto") == 5.0, "the robot's best method is its tuned set"
    # The baseline, a user's code, and a robot alone keep the files of the maker.
    for method in ({"method": "dwa"}, {"method": "mine.py:Mine"}, {}):
        assert range_with(**method) == 2.5


def test_a_robot_without_files_for_a_map():
    with pytest.raises(ApplrError, match=r"has no move_base\.with_map: give its files for a map"):
        with_robot({"robot": "jackal", "map": True})
    assert with_robot({"a": 1}) == ({"a": 1}, None)


def test_rviz_shows_topics_that_robots_and_local_planners_publish():
    published = {"/" + load(name).topics.scan for name in NAMES}
    for surface_file in ("move_base_surface.json", "dwa_surface.json"):
        published |= set(json.loads((DATA / surface_file).read_text())["publishes"])
    rviz_settings = yaml.safe_load((ROOT / "applr_ros1" / "rviz" / "applr.rviz").read_text())
    displays = rviz_settings["Visualization Manager"]["Displays"]
    shown_topics = [display["Topic"] for display in displays if "Topic" in display]
    # The C++ planner, whose topics the files list, has no such topics.
    ours_alone = {"move_base/TrajectoryPlannerROS/trajectory_cloud", "applr/local_goal"}
    assert {topic for topic in shown_topics if "/" + topic not in published} == ours_alone
    # Each planner has four displays, of which one planner's stay empty.
    assert sum("Trajectory" in topic for topic in shown_topics) == 4
    assert sum("DWA" in topic for topic in shown_topics) == 4
    # Relative names follow the namespace.
    for display in displays:
        for setting, setting_value in display.items():
            is_absolute = setting.endswith("Topic") and setting_value.startswith("/")
            assert not is_absolute, setting_value


@pytest.mark.slow
def test_install_space(tmp_path):
    """Executables, Python packages, generated configurations and data work from an install space
    alone.
    """
    # In an environment that knows no other workspace. Before the package is used, the sources and
    # the devel space are deleted.
    build_script = """
        set -e
        mkdir -p {ws}/src && ln -s {root}/.applr/catkin_ws/src/applr_ros1 {ws}/src/applr_ros1
        unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH
        options="-DPYTHON_EXECUTABLE=$(command -v python) -DCATKIN_ENABLE_TESTING=OFF"
        catkin_make -C {ws} $options install
        rm -rf {ws}/src {ws}/devel {ws}/build
        . {ws}/install/setup.sh
        cd /
        head -qn 1 {ws}/install/lib/applr_ros1/*.py | sort -u
        roslaunch --files applr_ros1 jackal_applr.launch
        roslaunch --nodes applr_ros1 jackal_applr.launch
        python -c "from applr_ros1.cfg import TrajectoryPlannerConfig"
        python -c "import applr_ros1.msg, applr_ros1.srv"
        python -c "import worlds, training; print(worlds.__file__)"
    """.format(ws=tmp_path, root=ROOT)
    built = inside("bash", "-c", build_script)
    assert built.returncode == 0, built.stdout[-2000:] + built.stderr[-2000:]

    # What the last commands printed: the first line of all programs (the interpreter, whatever is
    # on PATH), the launch file, the names of its nodes, and the module `worlds`.
    interpreter, launch_file, *node_names, module_file = built.stdout.splitlines()[-10:]
    install_space = str(tmp_path / "install")
    assert interpreter == "#!" + os.path.join(ROOT, ".applr", "venv", "bin", "python")
    assert launch_file.startswith(install_space)
    assert {"/sim_bridge", "/move_base", "/collision_monitor"} <= set(node_names)
    assert {"/movers", "/applr", "/black_box", "/send_goal"} <= set(node_names)
    assert module_file.startswith(install_space)


def demo(tmp_path, *arguments):
    """Start ./applr demo, with its page and its temporary files in a folder."""
    page_argument = "page:=%s" % (tmp_path / "drive.html")
    return subprocess.Popen(
        [APPLR, "demo", *arguments, page_argument],
        env=dict(os.environ, TMPDIR=str(tmp_path)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_demo_reaches_the_goal(tmp_path):
    running = demo(tmp_path, "world:=generated:41", "real_time_factor:=0")
    output, errors = running.communicate(timeout=HANGS)
    assert running.returncode == 0, output + errors

    # The last line is for programs.
    result = json.loads(output.splitlines()[-1])
    assert (result["world"], result["method"], result["success"]) == ("generated:41", "applr", True)
    assert 2.0 < result["time_s"] < 300.0
    assert {"collided", "skipped_cycles", "late_decisions"} <= set(result)

    # The lines before are for people.
    for progress in ("simulator.*up after", "move_base.*up after", "applr.*up after", "m to go"):
        assert re.search(progress, output), output
    assert "m to the finish line at y = 10 m" in output

    # The page has this drive, at 5 Hz, up to the finish line at 10 m. Poses are changes in cm.
    page = (tmp_path / "drive.html").read_text(encoding="utf-8")
    page_data = data_of(page)
    (world,) = page_data["worlds"]
    (drive,) = world["drives"]
    assert len(drive["p"]) == pytest.approx(result["time_s"] / 0.2, abs=2)
    assert np.cumsum(drive["p"], axis=0)[-1][1] >= 1000
    assert len(drive["theta"]) == len(drive["at"]) >= 2
    assert len(drive["theta"][0]) == len(page_data["parameters"])
    seconds = "{:.1f}&nbsp;s".format(result["time_s"])
    assert f'<p class="verdict">Reached the goal in {seconds}' in page
    assert result["page"] == str(tmp_path / "drive.html")


@pytest.mark.parametrize(
    ("goal", "sent"), [("auto", (-19.7, 0.0, math.pi)), ("25 0 0", (25.0, 0.0, 0.0))]
)
def test_demo_sends_the_same_goal_as_send_goal(monkeypatch, goal, sent):
    """A course's goal 20 m away, outside the map, is moved onto the map. A goal given by the user
    is sent unchanged.
    """
    course = worlds.Course(
        start=(11.0, 0.0, math.pi),
        goal=(-9.0, 0.0, math.pi),
        finish_y=None,
        goal_tolerance=1.0,
        path=np.empty((0, 2)),
    )
    world = worlds.World("far", np.empty((0, 3)), np.empty((0, 5)), course)
    monkeypatch.setattr(demo_tool.worlds, "load", lambda _, radius: world)
    setup = demo_tool.prepare([f"goal:={goal}"])
    assert setup.values["sent"] == pytest.approx(sent)


@pytest.mark.parametrize(
    ("speed", "gives_up_at", "goal", "reason", "time"),
    [
        (0.5, 99.0, "auto", "timed out", 2.0),
        (0.5, 1.0, "auto", "move_base gave up: no way", 1.0),
        (8.0, 99.0, "auto", "goal reached", 0.9),
        # The planner reports success 0.6 m from the goal, and 0.86 m from another.
        (0.5, 1.0, "0.6 0.5 0", "goal reached", 1.0),
        (0.5, 1.0, "1.2 0.5 0", TOO_EARLY, 1.0),
        # By the odometry, the robot is at this goal, 1 m from its start.
        (0.1, 1.0, "1 0 0", f"{ODOMETRY_ARRIVED}: its wheels slipped by 0.90 m over 1.0 m", 1.0),
    ],
)
def test_each_end_of_a_demo_has_its_reason(speed, gives_up_at, goal, reason, time, monkeypatch):
    """The robot goes straight from the start of the course to its end at `speed` [m/s].

    Its wheels turn at 1 m/s if it is slower than 0.5 m/s, and as fast as it goes else.
    """
    monkeypatch.setattr(demo_tool.rospy, "init_node", lambda *_, **__: None)
    monkeypatch.setattr(demo_tool.rospy, "Subscriber", lambda *_, **__: None)
    setup = demo_tool.prepare(["world:=generated:0", f"goal:={goal}"])
    observer = demo_tool.Observer(setup)
    motions = []

    def move_to(*motion):
        motions.append(Reading(*motion))
        observer.take_motion(motions[-1])
        wheel_speed = speed if speed >= 0.5 else 1.0
        rolled = wheel_speed * (motions[-1].time - 1.0)
        observer.take_odometry(Reading(motions[-1].time, (rolled, 0.0, 0.0), (wheel_speed, 0.0)))

    def check():
        """Move on by 0.1 s."""
        motion = motions[-1]
        x, y, yaw = motion.pose
        next_pose = x + 0.1 * speed * math.cos(yaw), y + 0.1 * speed * math.sin(yaw), yaw
        move_to(motion.time + 0.1, next_pose, motion.twist)

    def state():
        if motions[-1].time - 1.0 < gives_up_at - 1e-6:
            return GoalStatus.ACTIVE
        return GoalStatus.ABORTED if goal == "auto" else GoalStatus.SUCCEEDED

    # The clock stands at 1 s when the drive begins.
    move_to(1.0, setup.world.course.start, (speed, 0.0))
    client = create_autospec(actionlib.SimpleActionClient, instance=True)
    client.get_state.side_effect = state
    client.get_goal_status_text.return_value = "no way"
    observer.client = client
    drive = observer.drive(2.0, check)
    last_goal = drive.goals[-1]
    assert last_goal.end == pytest.approx(time, abs=0.11)
    assert last_goal.reason == reason
    assert drive.truth.length == pytest.approx(speed * last_goal.end)
    assert client.send_goal.call_args.args[0].target_pose.header.frame_id == "odom"
    # actionlib logs an error if a client cancels a goal that has ended.
    assert client.cancel_goal.call_count == (state() == GoalStatus.ACTIVE)


def test_a_demo_listens_to_the_topics_that_its_arguments_choose(monkeypatch):
    topics = []
    monkeypatch.setattr(demo_tool.rospy, "init_node", lambda *_, **__: None)
    monkeypatch.setattr(demo_tool.rospy, "Subscriber", lambda topic, *_, **__: topics.append(topic))
    arguments = ["world:=generated:0", "odom_topic:=matched/odometry", "scan_topic:=/rear/scan"]
    demo_tool.Observer(demo_tool.prepare(arguments))
    assert {"/matched/odometry", "/rear/scan"} <= set(topics)
    assert not {JACKAL.topics.odometry, JACKAL.topics.scan} & {name.lstrip("/") for name in topics}


@pytest.mark.parametrize(
    ("spoiled", "end"), [("", " m"), ("this machine was too busy", "; this machine was too busy")]
)
def test_the_headline_of_a_demo_says_what_a_busy_machine_has_spoiled(spoiled, end, monkeypatch):
    monkeypatch.setattr(demo_tool, "page", lambda **values: values["verdict"])
    times = np.arange(0.0, 1.0, 0.1)
    drive = driven(times, pose=np.zeros((10, 3)), twist=np.zeros((10, 2)))
    drive.goals = [Goal("goal", 0.0, 1.0, REACHED, "goal reached")]
    setup = demo_tool.prepare(["world:=generated:0"])
    names = {"robot": "jackal", "world": "w", "method": "dwa", "simulator": "kinematic", "seed": 0}
    headline = demo_tool.headline_page(drive, setup, 0.0, names, spoiled)
    assert headline.startswith("Reached the goal in 1.0 s, ")
    assert headline.endswith(end)


def test_a_failed_demo_says_how_to_ask_why():
    robot = load("husky")
    assert "record:=$PWD/drive.bag" in demo_tool.how_to_ask_why("none", robot)
    command_line = demo_tool.how_to_ask_why("/tmp/husky.bag", robot)
    assert command_line == f"for the reason: ./applr why /tmp/husky.bag --robot {robot.folder}"


def test_a_demo_that_does_not_arrive_ends_with_1(monkeypatch, capsys):
    def drive(stack, setup, result):
        result["reason"] = "timed out"

    monkeypatch.setattr(demo_tool, "private_nodes", lambda given: contextlib.nullcontext())
    monkeypatch.setattr(demo_tool, "drive_course", drive)
    monkeypatch.setattr("sys.argv", ["demo.py", "page:=none"])
    assert demo_tool.main() == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["reason"] == "timed out"


@pytest.mark.fault("23")
@pytest.mark.slow
def test_an_interrupted_demo_leaves_no_process(tmp_path, measured):
    """All processes end within five seconds, without the time for which they wait for a
    processor.
    """
    running = demo(tmp_path, "world:=generated:1")
    for progress_line in running.stdout:
        if "goal sent" in progress_line:
            break
    children = psutil.Process(running.pid).children(recursive=True)
    assert len(children) >= 5
    stopwatch = Kept()
    began = time.monotonic()
    running.send_signal(signal.SIGINT)

    def has_ended():
        # The waiting time of a process is known only while it lives.
        stopwatch.waiting()
        return running.poll() is not None

    wait_for(has_ended, "the end")
    assert running.returncode == 130
    duration = time.monotonic() - began
    measured("everything has ended after", duration, "s")
    assert duration < 5.0 + stopwatch.waiting()
    assert not [child for child in children if is_alive(child.pid)]
    assert not (tmp_path / "drive.html").exists()
    assert not list(tmp_path.glob("applr_demo_*"))  # the log is deleted, too
