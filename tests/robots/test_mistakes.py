"""Tests of the messages about common mistakes in a robot's folder, which are the same for every
command.

Each message equals the one in messages.txt, which a person has read. After a deliberate change,
`python -m tests.robots.test_mistakes` rewrites this file: read what differs.
"""

import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER
from applr_ros1.planner.parameters.layers import COSTMAPS as COSTMAP_NAMES
from applr_ros1.robots import NAMES, load
from applr_ros1.robots import folder as folders
from applr_ros1.robots.check import check, crossed_limits, remarks
from training.evaluate import __main__ as evaluate
from training.robot import check as check_robot
from training.train import __main__ as train

# Files of the Jackal's folder, then of the TurtleBot3 burger's
ROBOT = "robot.yaml"
COSTMAPS = "costmap_common_params.yaml"
PLANNER = "base_local_planner_params.yaml"
MOVE_BASE = "move_base_params.yaml"
BURGER = "dwa_local_planner_params_burger.yaml"
LOCAL = "local_costmap_params.yaml"
APPROVED = Path(__file__).with_name("messages.txt")
# The footprints in these files
OUTLINE = '"[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"'
BURGER_OUTLINE = "footprint: [[-0.105, -0.105], [-0.105, 0.105], [0.041, 0.105], [0.041, -0.105]]"

# Rows are (file, original text, mistake); without file here. Each one holds one rule of the check:
# spelling, kinds of values, ranges, and how robot.yaml agrees with the parameter files.
IN_ROBOT_YAML = [
    ("wheel_radius:", "wheel_raduis:"),
    ("laser:\n", "lasre:\n"),
    ("  beams: 720\n", ""),
    ("frames: {base: base_link, odom: odom}", "frames:"),
    ("  beams: 720\n", "  beams: 1\n"),
    ("  beams: 720\n", "  beams: many\n"),
    ("wheel_radius: 0.098", "wheel_radius: round"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [1, 2, 3, 4]"),
    ("pose: [0.055, 0.0, 0.0]", "pose: front"),
    ("frame: front_laser", "frame: front laser"),
    (
        "vx_samples: {range: [4, 20], integer: true, sets: [{server: TrajectoryPlannerROS}]}",
        "vx_samples: 12",
    ),
    ("drive: skid_steer", "drive: omni"),
    ("size: [0.420, 0.310, 0.184]", "size: [42.0, 0.310, 0.184]"),
    ("range: [4, 20]", "range: [20, 4]"),
    ("  wheelbase: 0.262\n", ""),
    ("last_angle: 2.35619", "last_angle: -3.0"),
    ("range_max: 30.0", "range_max: 0.1"),
    ("deceleration: 1.9,", "deceleration: 30.0,"),
    ("yaw_deceleration: 3.3", "yaw_deceleration: 30.0"),
    ("range: [4, 20]", "range: [8, 20]"),
    ("local_costmap/inflater_layer}", "local_costmap/inflation_layer}"),
    ("name: path_distance_bias", "name: path_distance"),
    ("range: [4, 60], integer: true", "range: [4, 60]"),
    ("range: [0.1, 1.5]", "range: [0.1, 15.0]"),
    ("axle_height: 0.0345", "axle_height: 0.5"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [5.5, 0.0, 0.0]"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [-5.5, 0.0, 0.0]"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [0.055, 5.5, 0.0]"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [0.055, -5.5, 0.0]"),
    ("com: [0.0147, 0.0019, 0.0779]", "com: [0.147, 0.0019, 0.0779]"),
    (
        "file: base_local_planner_params.yaml",
        "file: base_local_planner_params.yaml, namespace: TrajectoryPlannerROS",
    ),
    ("range: [0.2, 2.0]", "range: [0.2, 2.5]"),
]
# Errors in the parameter files, with which move_base would not drive
OF_JACKAL = [
    (MOVE_BASE, "TrajectoryPlannerROS", "TebLocalPlannerROS"),
    (MOVE_BASE, "base_local_planner/TrajectoryPlannerROS", "dwa_local_planner/DWAPlannerROS"),
    (COSTMAPS, OUTLINE, "[[-21, -16.5], [-21, 16.5], [21, 16.5], [21, -16.5]]"),
    (COSTMAPS, OUTLINE, "[[-0.21, -1], [-0.21]]"),
    (COSTMAPS, OUTLINE, "[[0.21, 0.165], [-0.21, -0.165], [0.21, -0.165], [-0.21, 0.165]]"),
    (COSTMAPS, "footprint_padding: 0.1", "footprint_padding: 10"),
    (COSTMAPS, "topic: front/scan", "topic: scan"),
    (COSTMAPS, "max_obstacle_height: 2.0", "max_obstacle_height: 0.2"),
    (COSTMAPS, "  observation_sources: scan\n", ""),
    (COSTMAPS, "_frame: base_link", "_frame: base"),
    (PLANNER, "sim_time: 2.0", "sim_time: .inf"),
]
OF_BURGER = [
    (LOCAL, "global_frame: odom", "global_frame: map"),
    (LOCAL, "rolling_window: true", "origin_x: -1.0"),
    (ROBOT, "static_map: false, ", ""),
    (BURGER, "max_vel_trans: 0.22", "max_vel_trans: 0.08"),
    (BURGER, "max_vel_x: 0.22", "max_vel_x: 0.08"),
]
# Remarks: move_base drives with these, but hardly as intended
REMARKS_OF_JACKAL = [
    (PLANNER, "max_vel_x: 0.5", "max_vel_x: 2.0"),
    (COSTMAPS, "inflation_radius:", "inflation_radus:"),
    (PLANNER, "max_vel_x: 0.5", "max_vel_x: 0.5\n  max_vel_xx: 1.0"),
    (PLANNER, "max_vel_x: 0.5", "max_vel_x: '0.5'"),
    (PLANNER, "min_vel_x: 0.1", "min_vel_x: 0.8"),
    (PLANNER, "max_vel_x: 0.5", "max_vel_x: 5.0"),
    (COSTMAPS, OUTLINE, "[[-.1, -.1], [-.1, .1], [.1, .1], [.1, -.1]]"),
    (COSTMAPS, "_frame: front_laser", "_frame: laser"),
]
REMARKS_OF_BURGER = [
    (BURGER, "max_vel_trans: 0.22", "max_vel_trans: 0.15"),
    (BURGER, "max_vel_theta: 2.75", "max_vel_theta: 0.5"),
    (BURGER, "sim_time: 1.5", "max_rot_vel: 1.0"),
    (BURGER, "min_vel_y: 0.0", "min_vel_y: -0.1"),
    (BURGER, "acc_lim_x: 2.5", "acc_lim_x: 250"),
    (COSTMAPS.replace(".", "_burger."), BURGER_OUTLINE, ""),
    (LOCAL, "robot_base_frame: base_footprint", "robot_base_frame: base_link"),
    (LOCAL, "robot_base_frame: base_footprint", "robot_base_frame: /base_footprint"),
    (LOCAL, "global_frame: odom", "global_frame: /odom"),
]


def of_both(jackals, burgers):
    """Return the rows of two lists with the name of their robot in front."""
    return [("jackal", *row) for row in jackals] + [("turtlebot3_burger", *row) for row in burgers]


def changed(folder, robot, file, old, new):
    """Copy a robot's folder, put a mistake into one of its files, and return the path."""
    shutil.copytree(load(robot).folder, folder)
    changed_file = folder / file
    text = changed_file.read_text()
    # Without the text the folder would stay right, and a test that expects no line would pass.
    assert old in text
    changed_file.write_text(text.replace(old, new))
    return str(folder)


ERRORS = of_both([*((ROBOT, *row) for row in IN_ROBOT_YAML), *OF_JACKAL], OF_BURGER)
REMARKS = of_both(REMARKS_OF_JACKAL, REMARKS_OF_BURGER)


def errors_of(folder, *mistake):
    """Return the lines with which a robot is refused after a mistake in one of its files."""
    with pytest.raises(ApplrError) as refusal:
        load(changed(folder, *mistake))
    assert str(refusal.value).startswith(f"{folder}: ")
    return list(refusal.value.lines)


def remarks_of(folder, *mistake):
    """Return the remarks on a robot after a change of one of its files."""
    described = folders.read(changed(folder, *mistake))
    return [remark.line for remark in remarks(described)]


def title_of(robot, file, old, new):
    """Return the line above the messages about a mistake."""
    return f"{robot}/{file}: {old!r} -> {new!r}"


def approved():
    """Return the approved lines about each mistake, by its title."""
    lines_of_title = {}
    title = ""
    for line in APPROVED.read_text(encoding="utf-8").splitlines():
        if line.startswith(" "):
            lines_of_title[title].append(line.strip())
        else:
            title = line
            lines_of_title[title] = []
    return lines_of_title


@pytest.mark.parametrize("mistake", ERRORS, ids=str)
def test_an_error_is_the_approved_one(tmp_path, mistake):
    lines = errors_of(tmp_path / "mine", *mistake)
    assert lines == approved()[title_of(*mistake)]
    assert lines, "move_base would not drive"


@pytest.mark.parametrize("mistake", REMARKS, ids=str)
def test_a_remark_is_the_approved_one_and_stops_nothing(tmp_path, mistake):
    lines = remarks_of(tmp_path / "mine", *mistake)
    assert lines == approved()[title_of(*mistake)]
    assert lines, "move_base would hardly drive as intended"


def test_each_approved_message_is_of_a_mistake():
    assert list(approved()) == [title_of(*mistake) for mistake in ERRORS + REMARKS]


# As DWAPlannerROS accepts samples: it refuses those that are slower than min_vel_trans only if they
# also turn more slowly than min_vel_theta.
@pytest.mark.parametrize(
    ("values", "crossed"),
    [
        ({}, []),
        ({"max_vel_trans": 0.1}, []),
        ({"max_vel_trans": 0.08, "max_vel_x": 0.3}, [("min_vel_trans", "max_vel_trans")]),
        ({"max_vel_trans": 0.08, "min_vel_theta": 0.0}, []),
        ({"min_vel_trans": 0.6, "max_vel_trans": 0.7}, [("min_vel_trans", "max_vel_x")]),
        ({"min_vel_x": 0.4, "max_vel_trans": 0.3}, [("min_vel_x", "max_vel_trans")]),
        ({"max_vel_theta": 0.3}, [("min_vel_theta", "max_vel_theta")]),
        ({"max_vel_theta": 0.3, "min_vel_trans": 0.0}, []),
    ],
)
def test_smallest_and_largest_values_of_dwa_are_compared(values, crossed):
    defaults = {parameter.name: parameter.default for parameter in DWA_PLANNER}
    limits = crossed_limits("DWAPlannerROS", {**defaults, **values})
    assert [(pair.low, pair.high) for pair in limits] == crossed


def test_turns_in_place_faster_than_the_fastest_turn_are_remarked(tmp_path):
    mistake = ("min_in_place_vel_theta: 0.314", "min_in_place_vel_theta: 1.7")
    described = folders.read(changed(tmp_path / "mine", "jackal", PLANNER, *mistake))
    (remark,) = remarks(described)
    assert "min_in_place_vel_theta is 1.7, larger than max_vel_theta (1.57)" in remark.line
    assert remark.correction == {"TrajectoryPlannerROS": {"min_in_place_vel_theta": 1.57}}


def test_a_range_of_clearing_below_that_of_marking_is_remarked():
    short = {"obstacles_layer": {"scan": {"obstacle_range": 2.5, "raytrace_range": 2.0}}}
    (remark,) = remarks(load("jackal").with_parameters({"local_costmap": short}, "mine"))
    assert remark.line == (
        "local_costmap/obstacles_layer/scan/raytrace_range is 2, below obstacle_range (2.5): what "
        "is marked beyond it is not cleared from there, raise it to 2.5"
    )
    assert remark.correction == {
        "local_costmap": {"obstacles_layer": {"scan": {"raytrace_range": 2.5}}}
    }


def test_an_inflation_that_lets_global_plans_through_too_narrow_gaps_is_remarked():
    def remarks_with(radius):
        inflation = dict.fromkeys(COSTMAP_NAMES, {"inflater_layer": {"inflation_radius": radius}})
        return remarks(load("jackal").with_parameters(inflation, "mine"))

    (remark,) = remarks_with(0.28)
    assert remark.line == (
        "global_costmap/inflater_layer/inflation_radius is 0.28: plans lead through gaps that are "
        "narrower than the robot, raise it to 0.29, for the footprint's inscribed radius"
    )
    assert remark.correction == {"global_costmap": {"inflater_layer": {"inflation_radius": 0.29}}}
    assert remarks_with(0.29) == []


def test_another_odometry_of_the_planner_than_of_the_monitor_is_remarked():
    def lines_with(topic):
        changes = {"DWAPlannerROS": {"odom_topic": topic}}
        described = load("turtlebot3_burger").with_parameters(changes, "mine")
        return [remark.line for remark in remarks(described)]

    assert lines_with("/odom") == []
    assert lines_with("wheels/odom") == [
        "DWAPlannerROS/odom_topic is wheels/odom, but topics.odometry in robot.yaml, which the "
        "collision monitor reads, is odom: give the same topic"
    ]


def test_the_correction_of_a_short_range_changes_no_other_laser_and_clears_no_less():
    def with_scan(**ranges):
        return {"obstacles_layer": {"scan": ranges}}

    changes = {
        "TrajectoryPlannerROS": {"max_vel_x": 2.0},
        "local_costmap": with_scan(obstacle_range=2.5, raytrace_range=6.0),
        "global_costmap": with_scan(obstacle_range=10.0, raytrace_range=12.0),
    }
    (remark,) = remarks(load("jackal").with_parameters(changes, "mine"))
    assert remark.line.endswith("give 4 and raytrace_range 6")
    corrected = with_scan(obstacle_range=4.0, raytrace_range=6.0)
    assert remark.correction == {"local_costmap": corrected}


@pytest.mark.parametrize("costmap", COSTMAP_NAMES)
def test_a_slash_alone_makes_no_other_frame(costmap):
    changes = {costmap: {"robot_base_frame": "/base_footprint"}}
    (remark,) = remarks(load("turtlebot3_burger").with_parameters(changes, "mine"))
    assert remark.line == (
        f"{costmap}/robot_base_frame is /base_footprint: Noetic's tf2 refuses frames that begin "
        "with a slash, give base_footprint"
    )


def test_a_sensor_frame_with_a_slash_is_remarked(tmp_path):
    old, new = "sensor_frame: front_laser", "sensor_frame: /front_laser"
    described = folders.read(changed(tmp_path / "mine", "jackal", COSTMAPS, old, new))
    lines = [remark.line for remark in remarks(described)]
    expected = (
        "scan/sensor_frame is /front_laser: Noetic's tf2 refuses frames that begin with a slash"
    )
    assert [line for line in lines if expected in line], lines


# A base ignores commands below its dead band (v [m/s], w [rad/s]). A planner's smallest velocity,
# and its first command from rest, which its acceleration and a period of 0.1 s allow, must lie
# above it.
@pytest.mark.parametrize(
    ("robot", "dead_band", "lines"),
    [
        ("jackal", (0.08, 0.25), []),
        (
            "jackal",
            (0.11, 0.1),
            ["min_vel_x is 0.1, but the base ignores .* robot.yaml .0.11.: raise it to 0.11$"],
        ),
        (
            "jackal",
            (0.0, 0.4),
            ["ROS/min_in_place_vel_theta is 0.314, but .* raise it to 0.4$"],
        ),
        (
            "turtlebot3_waffle_pi",
            (0.26, 0.34),
            [
                "min_vel_trans is 0.13, .* raise it to 0.26$",
                "ROS/acc_lim_x is 2.5: the first command from rest is at most 0.25, .* raise it "
                "to 2.6$",
                "ROS/acc_lim_theta is 3.2: .* at most 0.32, .* raise it to 3.4$",
            ],
        ),
    ],
)
def test_a_dead_band_names_the_parameters_that_are_too_small(robot, dead_band, lines):
    described = load(robot)
    base = described.base.model_copy(update={"dead_band": dead_band})
    remarked_lines = [remark.line for remark in remarks(replace(described, base=base))]
    assert len(remarked_lines) == len(lines), remarked_lines
    for pattern, line in zip(lines, remarked_lines):
        assert re.search(pattern, line), line


@pytest.mark.parametrize("name", NAMES)
def test_included_robots_have_no_errors_and_no_remarks(name):
    robot = load(name)
    # Some robots also come with the files for a drive on a map.
    setups = [robot]
    if robot.move_base.with_map is not None:
        setups.append(robot.on_map())
    for setup in setups:
        assert check(setup) == []
        assert remarks(setup) == []


def test_all_errors_in_robot_yaml_are_reported_at_once_before_those_of_parameters(tmp_path, capsys):
    folder = changed(tmp_path / "mine", "jackal", ROBOT, "max_speed: 2.0", "max_speed: fast")
    robot_yaml = Path(folder, ROBOT)
    robot_yaml.write_text(robot_yaml.read_text().replace("beams: 720", "beams: 1"))
    Path(folder, PLANNER).write_text(
        "TrajectoryPlannerROS: {sim_time: .nan, max_vel_x: .inf, max_vel_xx: 1.0}"
    )

    def assert_checked(errors, remarks):
        """Check the folder: it has these errors, in this order, and remarks."""
        folders.forget()
        assert check_robot.main([folder]) == 1
        output = capsys.readouterr()
        assert output.out.splitlines() == remarks
        lines = output.err.splitlines()
        assert len(lines) == len(errors), lines
        for line, field in zip(lines, errors):
            assert line.startswith("error: ")
            assert field in line

    # Parameters are compared with robot.yaml, so this must be right first.
    assert_checked(["base.max_speed", "laser.beams"], [])
    text = robot_yaml.read_text().replace("max_speed: fast", "max_speed: 2.0")
    robot_yaml.write_text(text.replace("beams: 1", "beams: 720"))
    unknown = "remark: TrajectoryPlannerROS/max_vel_xx: unknown, ignored"
    assert_checked(["sim_time", "max_vel_x"], [unknown])


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("<launch/>", "planner.yaml is a launch file: "),
        (
            "controller_frequency: $(arg rate)",
            r"controller_frequency is '\$\(arg rate\)', which only",
        ),
    ],
)
def test_a_parameter_file_that_only_roslaunch_reads_is_one_line(tmp_path, content, problem):
    old = "file: base_local_planner_params.yaml"
    folder = changed(tmp_path / "mine", "jackal", ROBOT, old, "file: planner.yaml")
    Path(folder, "planner.yaml").write_text(content)
    remedy = "give the output of roslaunch --dump-params PACKAGE FILE.launch$"
    with pytest.raises(ApplrError, match=f"{problem}.*{remedy}"):
        load(folder)


def test_a_parameter_file_that_cannot_be_read_is_one_line(tmp_path):
    old = "file: base_local_planner_params.yaml"
    folder = changed(tmp_path / "mine", "jackal", ROBOT, old, "file: planner.yaml")
    line = r"mine/planner.yaml: cannot be read .*give an existing file"
    with pytest.raises(ApplrError, match=line):
        load(folder)


def test_a_robot_whose_files_name_no_local_planner_drives_with_move_bases_default(tmp_path):
    named = "base_local_planner: base_local_planner/TrajectoryPlannerROS\n"
    folder = changed(tmp_path / "mine", "jackal", MOVE_BASE, named, "")
    assert load(folder).local_planner == "TrajectoryPlannerROS"


# Robot, file, text and mistake, as in the rows above, and the line about it
WRONG = ("turtlebot3_burger", BURGER, "max_vel_theta: 2.75", "max_vel_theta: .inf")
LINE = "/mine: DWAPlannerROS/max_vel_theta is inf: give a finite number"


@pytest.mark.parametrize("command", [evaluate, train])
def test_commands_stop_at_the_same_line(tmp_path, capsys, command):
    folder = changed(tmp_path / "mine", *WRONG)
    assert command.main(["--robot", folder, "--out", str(tmp_path / "out")]) == 1
    assert LINE in capsys.readouterr().err
    # Nothing has begun: a run that cannot be driven leaves no folder behind.
    assert not (tmp_path / "out").exists()


def write_messages():
    """Write messages.txt anew."""
    paragraphs = []
    with tempfile.TemporaryDirectory() as folder:
        for lines_of, mistakes in ((errors_of, ERRORS), (remarks_of, REMARKS)):
            for number, mistake in enumerate(mistakes):
                lines = lines_of(Path(folder, lines_of.__name__, str(number)), *mistake)
                paragraphs.append("\n    ".join([title_of(*mistake), *lines]))
    APPROVED.write_text("\n".join(paragraphs) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_messages()
