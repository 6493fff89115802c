"""Tests of the messages about common mistakes in a robot's folder, which are the same for every
command.
"""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER
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
# The footprints in these files
OUTLINE = '"[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"'
BURGER_OUTLINE = "footprint: [[-0.105, -0.105], [-0.105, 0.105], [0.041, 0.105], [0.041, -0.105]]"

# Rows are (file, original text, mistake, regular expression of the message); without file here.
# Each one holds one rule of the check: spelling, kinds of values, ranges, and how robot.yaml agrees
# with the parameter files. Expressions end where the remedy is unmistakable.
IN_ROBOT_YAML = [
    ("wheel_radius:", "wheel_raduis:", "base: wheel_raduis is unknown: did you mean wheel_radius"),
    ("laser:\n", "lasre:\n", "^lasre is unknown: did you mean laser"),
    ("  beams: 720\n", "", "laser.beams is missing: give it"),
    ("frames: {base: base_link, odom: odom}", "frames:", "frames.base is missing: give it"),
    ("  beams: 720\n", "  beams: 1\n", "laser.beams is 1: give at least 2$"),
    ("  beams: 720\n", "  beams: many\n", "laser.beams is 'many': give a whole number$"),
    ("wheel_radius: 0.098", "wheel_radius: round", "wheel_radius is 'round': give a number$"),
    ("pose: [0.055, 0.0, 0.0]", "pose: [1, 2, 3, 4]", "laser.pose is .*: give at most 3 values$"),
    ("pose: [0.055, 0.0, 0.0]", "pose: front", "laser.pose is 'front': give a list$"),
    (
        "frame: front_laser",
        "frame: front laser",
        "laser.frame is 'front laser': give a name without blanks and special characters$",
    ),
    (
        "vx_samples: {range: [4, 20], integer: true, sets: [{server: TrajectoryPlannerROS}]}",
        "vx_samples: 12",
        "parameter_space.vx_samples is 12: give range and sets$",
    ),
    ("drive: skid_steer", "drive: omni", "base.drive is 'omni': give 'skid_steer' or 'two_wheel'"),
    (
        "size: [0.420, 0.310, 0.184]",
        "size: [42.0, 0.310, 0.184]",
        r"body.size\[0\] is 42.0: give .* 10",
    ),
    (
        "range: [4, 20]",
        "range: [20, 4]",
        r"parameter_space.vx_samples: range is \[20, 4\]: give a smaller number",
    ),
    ("  wheelbase: 0.262\n", "", "base.wheelbase is 0: "),
    (
        "last_angle: 2.35619",
        "last_angle: -3.0",
        "laser.last_angle is -3: give more than .*-2.35619",
    ),
    (
        "deceleration: 1.9,",
        "deceleration: 30.0,",
        r"monitor.deceleration is 30, larger than .* \(20\)",
    ),
    (
        "range: [4, 20]",
        "range: [8, 20]",
        "parameter_space.vx_samples: move_base starts with 6; include it in the",
    ),
    (
        "local_costmap/inflater_layer}",
        "local_costmap/inflation_layer}",
        "inflation_radius: there is no server .*inflation_layer.*; did you mean "
        "local_costmap/inflater_layer",
    ),
    (
        "name: path_distance_bias",
        "name: path_distance",
        "pdist_scale: server .* has no number path_distance; ",
    ),
    (
        "range: [4, 60], integer: true",
        "range: [4, 60]",
        "vtheta_samples: integer is false, .* int: give integer: true",
    ),
    (
        "range: [0.1, 1.5]",
        "range: [0.1, 15.0]",
        "pdist_scale: server .* takes 0 to 5; stay within it",
    ),
    ("axle_height: 0.0345", "axle_height: 0.5", "base.axle_height is 0.5: .*0.402"),
    (
        "pose: [0.055, 0.0, 0.0]",
        "pose: [5.5, 0.0, 0.0]",
        r"laser.pose is \[5.5, 0, 0\]: .*0.229 .*0.208",
    ),
    (
        "com: [0.0147, 0.0019, 0.0779]",
        "com: [0.147, 0.0019, 0.0779]",
        r"body.com is \[0.147, 0.0019, 0.0779\]: ",
    ),
    (
        "file: base_local_planner_params.yaml",
        "file: base_local_planner_params.yaml, namespace: TrajectoryPlannerROS",
        "^TrajectoryPlannerROS/TrajectoryPlannerROS is one level too deep for move_base: remove "
        "the level",
    ),
    (
        "range: [0.2, 2.0]",
        "range: [0.2, 2.5]",
        r"parameter_space.max_vel_x.range is \[0.2, 2.5\], but .* is 2: stay",
    ),
]
# Errors in the parameter files, with which move_base would not drive
OF_JACKAL = [
    (
        MOVE_BASE,
        "TrajectoryPlannerROS",
        "TebLocalPlannerROS",
        "base_local_planner is .*Teb.*: give base_",
    ),
    (
        MOVE_BASE,
        "base_local_planner/TrajectoryPlannerROS",
        "dwa_local_planner/DWAPlannerROS",
        "base_local_planner is .*, but the files only hold parameters of TrajectoryPlannerROS: "
        "give ",
    ),
    (
        COSTMAPS,
        OUTLINE,
        "[[-21, -16.5], [-21, 16.5], [21, 16.5], [21, -16.5]]",
        "footprint.* 42.2 x 33.2 m.*metres",
    ),
    (
        COSTMAPS,
        OUTLINE,
        "[[-0.21, -1], [-0.21]]",
        r"footprint is \[\[-0.21, -1\], \[-0.21\]\]: give at least three",
    ),
    (
        COSTMAPS,
        OUTLINE,
        "[[0.21, 0.165], [-0.21, -0.165], [0.21, -0.165], [-0.21, 0.165]]",
        r"local_costmap/footprint is \[\[0.21, 0.165\], .* its sides cross each other: give the "
        "corners in their order around the robot",
    ),
    (
        COSTMAPS,
        "footprint_padding: 0.1",
        "footprint_padding: 10",
        "footprint_padding.* 20.4 x 20.3 m",
    ),
    (
        COSTMAPS,
        "topic: front/scan",
        "topic: scan",
        "obstacles_layer/scan/topic is scan, but .*: give front/scan",
    ),
    (
        COSTMAPS,
        "max_obstacle_height: 2.0",
        "max_obstacle_height: 0.2",
        "max_obstacle_height are -2, 0.2: .*0.333",
    ),
    (COSTMAPS, "  observation_sources: scan\n", "", "local_costmap has no observation source: "),
    (
        COSTMAPS,
        "_frame: base_link",
        "_frame: base",
        "robot_base_frame is base, but .*: give base_link",
    ),
    (
        PLANNER,
        "sim_time: 2.0",
        "sim_time: .inf",
        "TrajectoryPlannerROS/sim_time is inf: give a finite number",
    ),
]
OF_BURGER = [
    (
        LOCAL,
        "global_frame: odom",
        "global_frame: map",
        "local_costmap/global_frame is map, but .*: give odom",
    ),
    (
        LOCAL,
        "rolling_window: true",
        "origin_x: -1.0",
        "local_costmap/origin_y is 0: .* 3 m long.*give -1.5",
    ),
    (ROBOT, "static_map: false, ", "", "global_costmap/plugins has static_layer, but "),
    (
        BURGER,
        "max_vel_trans: 0.22",
        "max_vel_trans: 0.08",
        r"ROS/max_vel_trans is 0.08, below min_vel_trans \(0.11\): no straight .*, raise max_ve",
    ),
    (
        BURGER,
        "max_vel_x: 0.22",
        "max_vel_x: 0.08",
        r"ROS/max_vel_x is 0.08, below min_vel_trans \(0.11\): no straight command ahead .* raise",
    ),
]
# Remarks: move_base drives with these, but hardly as intended
REMARKS_OF_JACKAL = [
    (
        PLANNER,
        "max_vel_x: 0.5",
        "max_vel_x: 2.0",
        "scan/obstacle_range is 2.5: obstacles are marked 1.2 s ahead at max_vel_x .2.; "
        "give 4 and raytrace_range 4.5",
    ),
    (
        COSTMAPS,
        "inflation_radius:",
        "inflation_radus:",
        "inflation_radus is ignored: did you mean inflation_rad",
    ),
    (
        PLANNER,
        "max_vel_x: 0.5",
        "max_vel_x: 0.5\n  max_vel_xx: 1.0",
        "ROS/max_vel_xx: unknown, ignored",
    ),
    (
        PLANNER,
        "max_vel_x: 0.5",
        "max_vel_x: '0.5'",
        "max_vel_x is '0.5': the default 0.55 is used, as in C",
    ),
    (
        PLANNER,
        "min_vel_x: 0.1",
        "min_vel_x: 0.8",
        r"min_vel_x is 0.8, larger than max_vel_x \(0.5\): lower",
    ),
    (
        PLANNER,
        "max_vel_x: 0.5",
        "max_vel_x: 5.0",
        r"max_vel_x is 5: .*max_speed in robot.yaml \(2\)",
    ),
    (
        COSTMAPS,
        OUTLINE,
        "[[-.1, -.1], [-.1, .1], [.1, .1], [.1, -.1]]",
        "footprint is too small: .* 0.03 m",
    ),
    (
        COSTMAPS,
        "_frame: front_laser",
        "_frame: laser",
        "sensor_frame is laser, but .*: give front_laser",
    ),
]
REMARKS_OF_BURGER = [
    (
        BURGER,
        "max_vel_trans: 0.22",
        "max_vel_trans: 0.15",
        "ROS/max_vel_x is 0.22, DWAPlannerROS/max_vel_trans is 0.15: .* make them equal if",
    ),
    (
        BURGER,
        "max_vel_theta: 2.75",
        "max_vel_theta: 0.5",
        r"min_vel_theta is 1.37, larger than max_vel_theta \(0.5\): lower min_vel_theta",
    ),
    (BURGER, "sim_time: 1.5", "max_rot_vel: 1.0", "max_rot_vel is ignored: give max_vel_theta"),
    (BURGER, "min_vel_y: 0.0", "min_vel_y: -0.1", "min_vel_y, max_vel_y are .-0.1, 0.0.: .*give 0"),
    (
        BURGER,
        "acc_lim_x: 2.5",
        "acc_lim_x: 250",
        "acc_lim_x is 250.0: 20.0 is used, give a value from 0.0 to 20.0",
    ),
    (
        COSTMAPS.replace(".", "_burger."),
        BURGER_OUTLINE,
        "",
        r"footprint is missing: a circle of 0.46 m .*\[-0.102, -0.089\].*\[0.038, 0.089\]",
    ),
    (
        LOCAL,
        "robot_base_frame: base_footprint",
        "robot_base_frame: base_link",
        "robot_base_frame is base_link: both costmaps use base_footprint of global_costmap",
    ),
    (
        LOCAL,
        "robot_base_frame: base_footprint",
        "robot_base_frame: /base_footprint",
        "^local_costmap/robot_base_frame is /base_footprint: Noetic's tf2 refuses frames that "
        "begin with a slash, give base_footprint$",
    ),
    (
        LOCAL,
        "global_frame: odom",
        "global_frame: /odom",
        "^local_costmap/global_frame is /odom: Noetic's tf2 refuses .*, give odom$",
    ),
]


def of_both(jackals, burgers):
    """Return the rows of two lists with the name of their robot in front."""
    return [("jackal", *row) for row in jackals] + [("turtlebot3_burger", *row) for row in burgers]


def matching(pattern, lines):
    """Return the lines in which a regular expression is found."""
    return [line for line in lines if re.search(pattern, line)]


def changed(folder, robot, file, old, new):
    """Copy a robot's folder, put a mistake into one of its files, and return the path."""
    shutil.copytree(load(robot).folder, folder)
    changed_file = folder / file
    text = changed_file.read_text()
    # Without the text the folder would stay right, and a test that expects no line would pass.
    assert old in text
    changed_file.write_text(text.replace(old, new))
    return str(folder)


@pytest.mark.parametrize(
    ("robot", "file", "old", "new", "line"),
    of_both([*((ROBOT, *row) for row in IN_ROBOT_YAML), *OF_JACKAL], OF_BURGER),
)
def test_an_error_is_one_line_with_the_remedy(tmp_path, robot, file, old, new, line):
    with pytest.raises(ApplrError) as refusal:
        load(changed(tmp_path / "mine", robot, file, old, new))
    lines = refusal.value.lines
    # One mistake may have more lines than one, of which one is about it.
    assert matching(line, lines), lines
    assert "\n" not in "".join(lines)
    assert str(refusal.value).startswith(f"{tmp_path}/mine: ")


@pytest.mark.parametrize(
    ("robot", "file", "old", "new", "line"), of_both(REMARKS_OF_JACKAL, REMARKS_OF_BURGER)
)
def test_a_remark_stops_nothing(tmp_path, robot, file, old, new, line):
    described = folders.read(changed(tmp_path / "mine", robot, file, old, new))
    lines = [remark.line for remark in remarks(described)]
    assert matching(line, lines), lines


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


def test_a_slash_alone_makes_no_other_frame(tmp_path):
    old = "robot_base_frame: base_footprint"
    new = "robot_base_frame: /base_footprint"
    described = folders.read(changed(tmp_path / "mine", "turtlebot3_burger", LOCAL, old, new))
    (remark,) = remarks(described)
    assert remark.line.startswith(
        "local_costmap/robot_base_frame is /base_footprint: Noetic's tf2 refuses"
    )


def test_a_sensor_frame_with_a_slash_is_remarked(tmp_path):
    old, new = "sensor_frame: front_laser", "sensor_frame: /front_laser"
    described = folders.read(changed(tmp_path / "mine", "jackal", COSTMAPS, old, new))
    lines = [remark.line for remark in remarks(described)]
    assert matching("scan/sensor_frame is /front_laser: .*, give front_laser$", lines), lines


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
