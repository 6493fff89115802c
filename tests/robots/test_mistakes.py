"""Mistakes that people make in a robot's folder, and the lines about them: the same ones from every command."""

import re
import shutil
from pathlib import Path

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import NAMES, load, tell
from applr_ros1.robots import folder as folders
from applr_ros1.robots.check import findings, of_setup
from tests.support import DATA
from training import check_robot, evaluate, train


def mistakes():
    """(robot, file, what stands there, what is written instead, its remedy, all lines) of each row of the table."""
    for block in Path(DATA, "robot_mistakes.txt").read_text().split("\n\n"):
        head, *lines = block.splitlines()
        if lines and " | " in head and lines[0].startswith("    "):
            parts = [part.replace("\\n", "\n").replace("\\t", "\t") for part in f"{head} ".split(" | ")]
            place, old, new, remedy = [*parts[:-1], parts[-1].rstrip(" "), parts[1]][:4]
            robot, _, file = place.partition("/")
            yield robot, file, old, new, remedy, [line.strip() for line in lines]


def changed(folder, robot, file, old, new):
    """A copy of a robot's folder with a mistake in it."""
    shutil.copytree(load(robot).folder, folder)
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    return str(folder)


def checked(folder, capsys):
    """Exit status of the check, and its findings."""
    folders._read.cache_clear()
    status = check_robot.main([folder])
    printed = "".join(capsys.readouterr()).replace("check_robot.py: ", "error: ").replace(folder + "/", "")
    return status, [line for line in printed.splitlines() if re.match("error|warning|remark", line)]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("local_costmap: a", "local_costmap is 'a': give a mapping"),
        ("local_costmap: {plugins: [{name: a, type: [1]}]}", r"plugins has {'name': 'a', 'type': \[1\]}: give"),
        ("local_costmap: {plugins: {name: a, type: 'costmap_2d::ObstacleLayer'}}", "plugins has {'name': 'a', .*give"),
        (
            "local_costmap: {plugins: [seen]}",
            "plugins has 'seen': give .*Nav2's form, in ROS 1 it is {name: seen, type",
        ),
    ],
    ids=["a text", "a type", "no list", "names of Nav2"],
)
def test_what_no_file_of_parameters_holds_is_a_finding(tmp_path, text, line):
    folder = changed(
        tmp_path / "mine", "turtlebot3_burger", "local_costmap_params.yaml", "local_costmap:", text + "\nb:"
    )
    assert [
        found for found in findings(*folders.read(folder)) if found.severity == "error" and re.search(line, str(found))
    ]


@pytest.mark.parametrize(("robot", "file", "old", "new", "remedy", "lines"), mistakes())
def test_a_mistake_is_named_and_the_remedy_in_its_line_works(tmp_path, capsys, robot, file, old, new, remedy, lines):
    folder = changed(tmp_path / "mine", robot, file, old, new)
    status, printed = checked(folder, capsys)
    wanted = [".*".join(map(re.escape, line.split(" ... "))) for line in lines]
    assert len(printed) == len(wanted), printed
    assert all(map(re.match, wanted, printed)), printed
    assert status == lines[0].startswith("error")
    if " => " in remedy:
        file, _, texts = remedy.partition(": ")
        old, remedy = texts.split(" => ")
    path = Path(folder, file)
    text = (Path(load(robot).folder, file)).read_text()
    path.write_text(text.replace(old, remedy))
    status, left = checked(folder, capsys)
    assert status == 0, left
    assert not [line for line in left for begin in lines if line.startswith(begin.split(" ... ")[0])]


def test_all_findings_of_all_files_come_at_once(tmp_path, capsys):
    folder = changed(tmp_path / "mine", "jackal", "robot.yaml", "max_speed: 2.0", "max_speed: fast")
    for file, old, new in (
        ("robot.yaml", "  beams: 720\n", ""),
        ("robot.yaml", "size: [0.420, 0.310, 0.184]", "size: [0.420]"),
        ("robot.yaml", "last_angle: 2.35619", "last_angle: -3.0"),
        ("robot.yaml", "odom_nav_params/local", "local"),
        ("base_local_planner_params.yaml", "sim_time: 2.0", "sim_time: .nan"),
        ("costmap_common_params.yaml", "footprint_padding", "footprint_paddin"),
    ):
        text = Path(folder, file).read_text()
        assert old in text
        Path(folder, file).write_text(text.replace(old, new))
    words = ("max_speed", "body.size", "laser.beams", "last_angle", "cannot be read", "sim_time", "footprint_paddin")
    for found in (words, (*words[:4], *words[5:], "front/scan", "obstacle_range", "world_scale")):
        assert check_robot.main([folder]) == 1
        printed = "".join(capsys.readouterr()).splitlines()
        assert len(printed) == len(found), printed
        assert [any(word in line for line in printed) for word in found] == [True] * len(found), printed
        shutil.copy(Path(folder, "odom_nav_params", "local_costmap_params.yaml"), folder)
        file = Path(folder, "costmap_common_params.yaml")
        file.write_text(file.read_text().replace(" topic: front/scan", " topic: scan").replace("2.5", "5.5"))
        folders._read.cache_clear()


@pytest.mark.parametrize("name", NAMES)
def test_included_robots_have_no_errors(name):
    robot = load(name)
    setups = [False] if robot.move_base.with_map is None else [False, True]
    assert not [f for with_map in setups for f in of_setup(robot, with_map) if f.severity == "error"]


WRONG = ("turtlebot3_burger", "dwa_local_planner_params_burger.yaml", "max_vel_theta: 2.75", "max_vel_theta: .inf")
LINE = "/mine/dwa_local_planner_params_burger.yaml: DWAPlannerROS/max_vel_theta is inf: give a finite number"


@pytest.mark.parametrize("command", [evaluate, train])
def test_commands_stop_at_the_same_line(tmp_path, capsys, command):
    folder = changed(tmp_path / "mine", *WRONG)
    assert command.main(["--robot", folder, "--out", str(tmp_path / "out")]) == 1
    assert LINE in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.ros
def test_the_demo_and_the_node_stop_at_the_same_line(tmp_path):
    from applr_ros1.nodes.move_base.robot_parameters import with_robot
    from applr_ros1.nodes.tools import demo

    folder = changed(tmp_path / "mine", *WRONG)
    for start in (
        lambda: demo.prepare(["robot:=" + folder, "picture:=none"]),
        lambda: with_robot({"robot": folder}),
    ):
        with pytest.raises(ApplrError) as refused:
            start()
        assert str(refused.value).endswith(LINE)


def test_remarks_are_printed_once(tmp_path, capsys):
    folder = changed(tmp_path / "mine", "jackal", "robot.yaml", "world_scale: 1.0", "world_scale: 1.5")
    assert load(folder, tell) is load(folder, tell)
    (printed,) = capsys.readouterr().err.splitlines()
    assert printed.startswith(f"remark: {folder}/robot.yaml: world_scale is 1.5: ")


def test_warnings_come_again_at_the_end_of_the_process(tmp_path, capsys, monkeypatch):
    later = []
    monkeypatch.setattr("atexit.register", lambda *call: later.append(call))
    word = "inflation_radius:", "inflation_radus:"
    load(changed(tmp_path / "mine", "jackal", "costmap_common_params.yaml", *word), tell)
    said = capsys.readouterr().err
    ((repeat, found, process),) = later
    repeat(found, process)
    assert capsys.readouterr().err == said != ""
    repeat(found, process + 1)  # a worker's
    assert capsys.readouterr().err == ""


def test_a_window_is_judged_as_the_planner_judges_it(tmp_path):
    """A robot that stands must reach min_vel_trans or min_vel_theta within one control period."""
    folder = tmp_path / "mine"
    changed(folder, "turtlebot3_burger", "dwa_local_planner_params_burger.yaml", "acc_lim_x: 2.5", "acc_lim_x: 1.0")
    file = folder / "dwa_local_planner_params_burger.yaml"
    limits = file.read_text()
    for least, turn, refused in (("1.37", "13.6", True), ("1.37", "13.8", False), ("0.1", "2.0", False)):
        text = limits.replace("min_vel_theta: 1.37", f"min_vel_theta: {least}")
        file.write_text(text.replace("acc_lim_theta: 3.2", f"acc_lim_theta: {turn}"))
        folders._read.cache_clear()
        assert any("every sample is refused" in f.advice for f in of_setup(load(str(folder), list))) == refused
    assert of_setup(load("jackal")) == []
