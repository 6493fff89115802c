"""Tests of ./applr robot, which writes a robot's folder from its URDF or xacro file and its
parameter files.

owners/ contains URDFs in the style of several makers, with the dimensions of the included robots.
"""

import os
import re
from pathlib import Path
from typing import Any, Dict, NamedTuple

import numpy as np
import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots.rviz_model import urdf as urdf_of
from applr_ros1.robots.urdf_import import urdf as urdf_reader
from training.robot import __main__ as new_robot
from training.robot import check as check_robot

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("xacrodoc")

OWNERS = Path(__file__).parent / "owners"
FOLDERS = {
    "waffle": Path(robots.load("turtlebot3_waffle_pi").folder),
    "husky": Path(robots.load("husky").folder),
    "jackal": Path(robots.load("jackal").folder),
}
HUSKY_CONTROLLER = OWNERS / "husky_description/control.yaml"


def link(name, shape="", mass=0.0, at="0 0 0"):
    """Return a link with one collision shape and an inertia."""
    moments = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/>{moments}</inertial>' if mass else ""
    collision = (
        f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>' if shape else ""
    )
    return f'<link name="{name}">{inertial}{collision}</link>'


def joint(child, at, parent="base_link", kind="fixed", axis="0 1 0", turn="0 0 0", more=""):
    """Return a joint between two links, with its place and axis."""
    links = f'<parent link="{parent}"/><child link="{child}"/>'
    place_and_axis = f'<origin xyz="{at}" rpy="{turn}"/><axis xyz="{axis}"/>'
    return f'<joint name="{child}_joint" type="{kind}">{links}{place_and_axis}{more}</joint>'


def wheel(name, at, axis="0 0 1", turn="-1.5707963 0 0", radius=".05", kind="continuous", **more):
    """Return a wheel with its joint: width .02 m, mass .4 kg."""
    cylinder = f'<cylinder radius="{radius}" length=".02"/>'
    return link(name, cylinder, 0.4) + joint(name, at, kind=kind, axis=axis, turn=turn, **more)


# Laser of 361 rays at a resolution of 2, which Gazebo's sensor interpolates to 722
RAYS = """
<gazebo reference="scanner">
  <sensor name="rays" type="gpu_ray">
    <update_rate>20</update_rate>
    <ray>
      <scan>
        <horizontal>
          <samples>361</samples>
          <resolution>2</resolution>
          <min_angle>-1.5</min_angle>
          <max_angle>1.4</max_angle>
        </horizontal>
      </scan>
      <range><min>.1</min><max>8</max></range>
      <noise><stddev>.005</stddev></noise>
    </ray>
  </sensor>
</gazebo>"""
# The outline of the cart: 0.3 x 0.2 m around a centre 5 cm behind base_link
HULL = link("base_link", '<box size=".3 .2 .1"/>', 5.0, at="-.05 0 .06")
SCANNER = link("scanner", '<cylinder radius=".03" length=".04"/>', 0.8) + joint(
    "scanner", ".05 0 .15"
)
BODY = (
    '<link name="base_footprint"/>'
    + joint("base_link", "0 0 .05", "base_footprint")
    + HULL
    + SCANNER
    + RAYS
)
CASTER = link("swivel") + joint("swivel", "-.15 0 -.02", kind="continuous", axis="0 0 1")
CASTER += link("roller", '<sphere radius=".03"/>', 0.2) + joint(
    "roller", "0 0 0", "swivel", "continuous"
)
WHEELS = wheel("left", "0 .12 0") + wheel("right", "0 -.12 0")
CART = BODY + WHEELS + CASTER
# Costmaps with a map, and with a bumper that is no laser: without a map, neither remains.
COMMON = """\
robot_base_frame: base_footprint
footprint: [[-0.2, -0.13], [-0.2, 0.13], [0.1, 0.13], [0.1, -0.13]]
footprint_padding: 0.01
plugins:
  - {name: map, type: "costmap_2d::StaticLayer"}
  - {name: seen, type: "costmap_2d::VoxelLayer"}
  - {name: margin, type: "costmap_2d::InflationLayer"}
seen:
  observation_sources: bumper scan
  scan: {data_type: LaserScan, topic: scan, marking: true, clearing: true}
  bumper: {data_type: PointCloud2, topic: bumps, marking: true, clearing: true}
margin: {inflation_radius: 0.3}
"""
# As most launch files do, it adds to the common parameters of both costmaps.
LOCAL = "{global_frame: odom_comb, rolling_window: true, width: 5, height: 5}\n"
# Angles in both notations of roslaunch's YAML
PLANNER = """\
NavfnROS: {allow_unknown: false}
DWAPlannerROS:
  {max_vel_x: 0.4, max_vel_trans: 0.45, min_vel_y: 0.0, max_vel_y: 0.0, max_vel_theta: rad(pi/2),
   acc_lim_x: 1.0, acc_lim_theta: 3.0, min_vel_theta: !degrees 6.0}
"""
# Joints alone and in a list. A limit counts only where its has_ is true: here not the turn rate.
CONTROLLER = """\
joint_publisher: {type: joint_state_controller/JointStateController, publish_rate: 50}
crate_controller:
  type: diff_drive_controller/DiffDriveController
  left_wheel: [left_joint]
  right_wheel: right_joint
  linear:
    x: {has_velocity_limits: true, max_velocity: 0.6,
        has_acceleration_limits: true, max_acceleration: 1.5}
  angular:
    z: {has_velocity_limits: false, max_velocity: 9.0,
        has_acceleration_limits: true, max_acceleration: 25.0}
"""
FILES = {"common.yaml": COMMON, "local.yaml": LOCAL, "dwa.yaml": PLANNER}
PLACES = [
    "common.yaml:global_costmap",
    "common.yaml:local_costmap",
    "local.yaml:local_costmap",
    "dwa.yaml",
]
# Arguments of `make` for a cart whose wheels are in a controller's file
CONTROLLED = {"files": {"control.yaml": CONTROLLER}, "places": [*PLACES, "control.yaml"]}


class Written(NamedTuple):
    """Exit status and output of the command, and the values of robot.yaml; {} if there is none."""

    status: int
    output: str
    values: Dict[str, Any]


def run(urdf, parameters, out, capsys, words=()):
    """Run the command, which writes the robot's folder."""
    files = list(map(str, parameters))
    status = new_robot.main([str(urdf), *words, "--out", str(out), "--parameters", *files])
    printed = capsys.readouterr()
    robot_yaml = out / "robot.yaml"
    values = yaml.safe_load(robot_yaml.read_text()) if robot_yaml.exists() else {}
    return Written(status, printed.out + printed.err, values)


@pytest.fixture
def make(tmp_path, capsys):
    """Return a function that writes the files of a cart, then calls `run` on them."""

    def write(
        urdf,
        *words,
        files=None,
        places=PLACES,
        name="crate.urdf",
        whole="<robot name='crate'>{}</robot>",
    ):
        texts = {**FILES, **(files or {}), name: whole.format(urdf)}
        for file_name, text in texts.items():
            (tmp_path / file_name).write_text(text)
        parameter_files = [tmp_path / place for place in places]
        return run(tmp_path / name, parameter_files, tmp_path / "my_robot", capsys, words)

    return write


def fill(folder, **values):
    """Fill in values in robot.yaml, and accept the proposals for all other fields."""
    robot_yaml = folder / "robot.yaml"
    text = robot_yaml.read_text()
    filled_values = {"mass": 6.0, "wheel_mass": 0.4, **values}
    for field, filled_value in filled_values.items():
        text = re.sub(rf"^  # {field}: .*", f"  {field}: {filled_value}", text, flags=re.MULTILINE)
    # Proposals stand behind the names of their fields.
    text = re.sub(r"^  # (\w+: \S+)", r"  \1", text, flags=re.MULTILINE)
    robot_yaml.write_text(text)
    # The folder may have been read before.
    robots.folder.forget()


def asked(output):
    """Return the fields that the command asks its user to fill in."""
    return re.findall(r"^  (\w+\.\w+) ", output, re.MULTILINE)


# What no URDF has
LIMITS = [
    "base.max_speed",
    "base.max_yaw_rate",
    "base.max_acceleration",
    "base.max_yaw_acceleration",
]
BRAKING = ["monitor.deceleration", "monitor.yaw_deceleration"]
SCAN = ["beams", "first_angle", "last_angle", "range_min", "range_max", "rate"]
NO_RETURN = "laser.no_return"  # the driver's, not the scanner's
MAKERS = {  # arguments, parameter files in the folder of the included robot, fields to fill in
    "waffle": (
        [],
        [
            "costmap_common_params_waffle_pi.yaml:global_costmap",
            "costmap_common_params_waffle_pi.yaml:local_costmap",
            "local_costmap_params.yaml",
            "global_costmap_params.yaml",
            "move_base_params.yaml",
            "dwa_local_planner_params_waffle_pi.yaml",
        ],
        [*LIMITS, "base.wheel_mass", "base.casters", "body.mass", NO_RETURN, *BRAKING],
    ),
    "husky": (
        ["laser_enabled:=true"],
        [
            "planner.yaml",
            "costmap_common.yaml:global_costmap",
            "costmap_common.yaml:move_base/local_costmap",
            "costmap_local.yaml:/move_base/local_costmap",
            "costmap_global_static.yaml:global_costmap",
            HUSKY_CONTROLLER,
        ],
        ["base.wheel_mass", "body.mass", NO_RETURN],
    ),
    "jackal": (
        [],
        [
            "move_base_params.yaml",
            "base_local_planner_params.yaml",
            "costmap_common_params.yaml:global_costmap",
            "costmap_common_params.yaml:local_costmap",
            "odom_nav_params/global_costmap_params.yaml",
            "odom_nav_params/local_costmap_params.yaml",
        ],
        [
            *LIMITS,
            "base.wheel_mass",
            "body.mass",
            *(f"laser.{name}" for name in SCAN),
            NO_RETURN,
            *BRAKING,
        ],
    ),
}
# What the user fills in for these robots
FILLED = {
    "casters": "[[-0.177, 0.064], [-0.177, -0.064]]",
    "mass": 40.0,
    "wheel_mass": 0.5,
    "beams": 720,
    "rate": 50.0,
    "first_angle": -2.35619,
    "last_angle": 2.35619,
    "range_min": 0.1,
    "range_max": 30.0,
}


@pytest.mark.parametrize("name", MAKERS)
def test_robots_of_makers_are_read_to_the_number(name, tmp_path, capsys):
    words, parameters, fields_to_fill_in = MAKERS[name]
    (urdf,) = (OWNERS / f"{name}_description/urdf").iterdir()
    # An absolute path, such as that of the controller's file, replaces the folder.
    parameter_files = [FOLDERS[name] / parameter_file for parameter_file in parameters]
    written = run(urdf, parameter_files, tmp_path, capsys, words)
    assert written.status == 0, written.output
    assert asked(written.output) == fields_to_fill_in

    included_values = yaml.safe_load((FOLDERS[name] / "robot.yaml").read_text())
    for section in ("base", "body", "laser"):
        for field, written_value in written.values[section].items():
            # A URDF has the noise of its simulation. Not all included robots give the other two.
            if field not in ("noise", "centre", "bottom"):
                included_value = included_values[section][field]
                assert written_value == pytest.approx(included_value, abs=2e-3), field
    assert written.values["world_scale"] == included_values["world_scale"]

    fill(tmp_path, **FILLED)
    assert check_robot.main([str(tmp_path)]) == 0, capsys.readouterr()


def test_a_dump_of_roslaunch_is_one_parameter_file(make):
    # Given: the parameters of all nodes of a stack in a namespace, each with its full name
    global_values = yaml.safe_load(COMMON)
    local_values = {**global_values, **yaml.safe_load(LOCAL)}
    full_names = {
        "/rosdistro": "noetic",
        "/two/crate/left_wheel": "left_joint",
        "/two/crate/right_wheel": "right_joint",
        "/two/move_base/base_local_planner": "dwa_local_planner/DWAPlannerROS",
    }
    for parameter_name, local_value in local_values.items():
        full_names[f"/two/move_base/local_costmap/{parameter_name}"] = local_value
    for parameter_name, global_value in global_values.items():
        full_names[f"/two/move_base/global_costmap/{parameter_name}"] = global_value
    dump = yaml.safe_dump(full_names)

    written = make(CART, files={"dump.yaml": dump}, places=["dump.yaml"])

    assert written.status == 0, written.output
    assert "1 parameter file\n" in written.output
    assert "left_joint, right_joint, according to the controller's file" in written.output
    assert written.values["move_base"]["files"] == [{"file": "dump.yaml"}]
    assert written.values["frames"]["odom"] == "odom_comb"
    assert written.values["topics"]["scan"] == "scan"


def test_the_folder_of_a_cart_has_the_values_of_its_files(make, tmp_path, capsys):
    written = make(CART)
    assert written.status == 0, written.output
    values = written.values
    wheels = {"wheel_radius": 0.05, "wheel_width": 0.02, "track": 0.24, "axle_height": 0.05}
    assert values["base"] == {"drive": "two_wheel", **wheels}
    assert values["body"] == {"size": [0.3, 0.2, 0.16], "centre": [-0.05, 0.0], "bottom": 0.06}
    assert values["laser"] == {
        "frame": "scanner",
        "pose": [0.05, 0.0, 0.0],
        "height": 0.2,
        "rate": 20.0,
        "noise": 0.005,
        "beams": 722,
        "first_angle": -1.5,
        "last_angle": 1.4,
        "range_min": 0.1,
        "range_max": 8.0,
    }
    assert values["frames"] == {"base": "base_footprint", "odom": "odom_comb", "map": "map"}
    to_fill_in = [*LIMITS, "base.wheel_mass", "base.casters", "body.mass", NO_RETURN, *BRAKING]
    assert asked(written.output) == to_fill_in
    remedy = "six of them are in the file of the base's controller: add it to --parameters for"
    assert f"\n  ({remedy} the limits of base and the decelerations of monitor)\n" in written.output
    assert "only the laser scan, without bumps: correct it before" in written.output
    folder = tmp_path / "my_robot"
    robot_yaml = (folder / "robot.yaml").read_text()
    proposal = r"\[m/s\] largest speed .*; proposal: the planner's max_vel_trans\n"
    assert re.search(rf"  # max_speed: 0.45 +# {proposal}", robot_yaml)

    # It is usable once the missing values have been filled in.
    assert check_robot.main([str(folder)]) == 1
    assert "base.max_speed is missing" in capsys.readouterr().err
    fill(folder, casters="[[-0.15, 0.0]]")
    assert check_robot.main([str(folder)]) == 0, capsys.readouterr()

    # The parameters with a map, and without one
    robot = robots.load(str(folder))
    assert robot.parameters()["DWAPlannerROS"]["max_vel_theta"] == pytest.approx(np.pi / 2)
    for setup, layer_names, sources in (
        (robot.on_map(), ["map", "seen", "margin"], "bumper scan"),
        (robot, ["seen", "margin"], "scan"),
    ):
        parameters = setup.parameters()
        plugins = parameters["global_costmap"]["plugins"]
        assert [layer["name"] for layer in plugins] == layer_names
        assert parameters["local_costmap"]["seen"]["observation_sources"] == sources
        assert parameters["NavfnROS"]["allow_unknown"] is not setup.uses_map
    # Without a map, the global costmap is a square around the start.
    global_costmap = robot.parameters()["global_costmap"]
    assert global_costmap["global_frame"] == "odom_comb"
    assert global_costmap["width"] == 23
    assert global_costmap["origin_x"] == -11.5


CYLINDER = '<cylinder radius=".15" length=".1"/>'
# Its corners lie within the cylinder's bounds, but not within the cylinder.
CARRIER = link("carrier", '<box size=".28 .28 .05"/>') + joint("carrier", "-.05 0 .06")


@pytest.mark.parametrize(
    ("shape", "more", "is_round"),
    [
        (CYLINDER, "", True),
        ('<box size=".3 .3 .1"/>', "", False),
        (CYLINDER, CARRIER, False),
    ],
    ids=["cylinder", "box", "cylinder with corners"],
)
def test_a_body_is_round_if_it_lies_within_the_oval_of_its_bounds(shape, more, is_round, make):
    hull = link("base_link", shape, 5.0, at="-.05 0 .06")
    written = make(CART.replace(HULL, hull) + more)
    assert written.status == 0, written.output
    body = written.values["body"]
    assert body["size"][:2] == pytest.approx([0.3, 0.3])
    assert body.get("round", False) is is_round


@pytest.mark.parametrize("frame", ["odom", "map"])
def test_both_costmaps_may_be_in_one_frame_of_any_name(make, frame):
    # Without a static layer, the frame is that of the odometry.
    common = COMMON + "global_frame: any\n"
    if frame == "odom":
        common = re.sub("  - {name: map.*\n", "", common)
    files = {"common.yaml": common, "local.yaml": LOCAL.replace("global_frame: odom_comb, ", "")}
    assert make(CART, files=files).values["frames"] == {"base": "base_footprint", frame: "any"}


# A URDF requires it of revolute joints.
LIMIT = '<limit lower="-.5" upper=".5" effort="1" velocity="1"/>'
# A second pair of wheels, which nothing drives
IDLE = wheel("idle_left", "-.15 .05 0") + wheel("idle_right", "-.15 -.05 0")
# Suspension of the left wheel: it is no direct child of the body
ROCKER = (
    BODY
    + link("rocker")
    + joint("rocker", "0 0 0", kind="revolute", more=LIMIT)
    + wheel("right", "0 -.12 0")
)
DRIVE = """
<gazebo>
  <plugin name='d' filename='libgazebo_ros_diff_drive.so'>
    <leftJoint>left_joint</leftJoint>
    <rightJoint>right_joint</rightJoint>
  </plugin>
</gazebo>"""


@pytest.mark.parametrize(
    ("urdf", "more", "by"),
    [
        (CART, {}, "pairs of continuous joints"),
        (CART + IDLE + DRIVE, {}, "the drive plugin"),
        (CART + IDLE, CONTROLLED, "the controller's file"),
        (ROCKER + wheel("left", "0 .12 0", parent="rocker"), {}, "pairs of continuous joints"),
    ],
    ids=["pairs", "plugin", "controller", "below a rocker"],
)
def test_driven_wheels_are_identified_by_controller_plugin_or_pairs(make, urdf, more, by):
    written = make(urdf, **more)
    wheels = "(left|right)_joint, (left|right)_joint"
    assert re.search(f"the driven wheels are {wheels}, according to {by}", written.output)
    base = written.values["base"]
    assert base["drive"] == "two_wheel"
    assert base["track"] == 0.24
    assert base["wheel_radius"] == 0.05
    # A controller's file has limits, too, and is asked for without any.
    assert ("six of them are in the file of" in written.output) != bool(more)
    if more:
        assert base["max_speed"] == 0.6
        assert base["max_yaw_acceleration"] == 25.0
        assert base["command_timeout"] == 0.5
        assert "base.max_yaw_rate" in asked(written.output)
        # It is no file of move_base.
        for listed_file in written.values["move_base"]["files"]:
            assert listed_file["file"] != "control.yaml"
        assert written.values["monitor"] == {"deceleration": 1.5, "yaw_deceleration": 12.0}


# Both sides are exchanged, as where a base is driven with its back ahead.
MIRRORED = CONTROLLER.replace("left_joint", "x").replace("right_joint", "left_joint")
MIRRORED = MIRRORED.replace("[x]", "[right_joint]")
LENGTHS = "\n  wheel_radius: .1\n  wheel_separation: .3\n"
# Diameter and separation as in the URDF
SAME_DRIVE = "<wheelDiameter>.1</wheelDiameter><wheelSeparation>.24</wheelSeparation></plugin>"


def controlled(text):
    """Return the arguments of `make` for a cart with another controller's file."""
    return {"files": {"control.yaml": text}, "places": CONTROLLED["places"]}


@pytest.mark.parametrize(
    ("urdf", "more", "lines"),
    [
        (CART + DRIVE.replace("</plugin>", SAME_DRIVE), CONTROLLED, []),
        (
            CART,
            controlled(MIRRORED),
            [
                "the controller's file: left_joint is on the right, but at y = 0.12 m: turns are "
                "mirrored, exchange left and right there",
                "the controller's file: right_joint is on the left, but at y = -0.12 m: .*",
            ],
        ),
        (
            CART + DRIVE.replace("leftJ", "rightJ", 1).replace("</leftJ", "</rightJ"),
            CONTROLLED,
            ["the drive plugin: left_joint is on the right, but at y = 0.12 m: .*"],
        ),
        (
            CART,
            controlled(CONTROLLER + LENGTHS),
            [
                "the radius of a wheel is 0.1 m in the controller's file, but 0.05 m in "
                ".*/crate.urdf: correct the wrong one",
                "the separation of the wheels is 0.3 m in the controller's file, but 0.24 m .*",
            ],
        ),
        (
            CART + DRIVE.replace("</plugin>", SAME_DRIVE.replace(">.1<", ">.2<")),
            {},
            ["the radius of a wheel is 0.1 m in the drive plugin, but 0.05 m in .*"],
        ),
    ],
    ids=["the same", "mirrored controller", "mirrored plugin", "lengths", "diameter"],
)
def test_statements_that_contradict_the_urdf_are_remarked(make, urdf, more, lines):
    written = make(urdf, **more)
    assert written.status == 0, written.output
    remarks = re.findall("^remark: (.*(?:mirrored|wrong).*)", written.output, re.MULTILINE)
    assert len(remarks) == len(lines), remarks
    for remark, line in zip(remarks, lines):
        assert re.fullmatch(line, remark)


# Without padding, the footprint of the cart is .3 x .26 m, as its body and wheels are.
@pytest.mark.parametrize(
    ("footprint", "sizes"),
    [
        ("[[-0.25, -0.19], [-0.25, 0.19], [0.19, 0.19], [0.19, -0.19]]", ""),
        ("[[-0.25, -0.2], [-0.25, 0.2], [0.2, 0.2], [0.2, -0.2]]", "0.45 x 0.40"),
        ("[[-0.2, -0.08], [-0.2, 0.08], [0.1, 0.08], [0.1, -0.08]]", "0.30 x 0.16"),
        # A circle contains the corners of a robot, here at .2 m from its centre.
        ("[]\nrobot_radius: 0.26", ""),
        ("[]\nrobot_radius: 0.3", "0.60 x 0.60"),
    ],
)
def test_a_footprint_of_another_size_than_the_robot_is_remarked(
    make, tmp_path, capsys, footprint, sizes
):
    common = re.sub("footprint: .*", f"footprint: {footprint}", COMMON)
    written = make(CART, files={"common.yaml": common})
    expected = []
    if sizes:
        robot = (
            "but body and wheels are 0.30 x 0.26 m: correct the footprint, or body in robot.yaml"
        )
        expected.append(f"the footprint is {sizes} m, {robot}")
    sentence = re.compile("^remark: .*(the footprint is .*)", re.MULTILINE)
    assert sentence.findall(written.output) == expected
    fill(tmp_path / "my_robot", casters="[[-0.15, 0.0]]")
    assert check_robot.main([str(tmp_path / "my_robot")]) == 0
    assert sentence.findall(capsys.readouterr().out) == expected


# Gazebo moves a body with this plugin in all directions, whatever wheels it has.
PLANAR = "<gazebo><plugin name='p' filename='planar_move.so'/></gazebo>"
# Steering of a car's wheel
KNUCKLE = link("knuckle") + joint("knuckle", ".2 0 0", kind="revolute", axis="0 0 1", more=LIMIT)


@pytest.mark.parametrize(
    ("urdf", "more", "why"),
    [
        (BODY, {}, r"\(none\) do not form one or two pairs"),
        (
            CART.replace("continuous", "fixed"),
            CONTROLLED,
            "left_joint is steered, or not continuous",
        ),
        (CART + IDLE + PLANAR, {}, "planar_move.so belongs to a base that"),
        (
            CART.replace('"left"', '"mecanum_left"'),
            {},
            "mecanum_left belongs to a base that also drives sideways",
        ),
        (
            CART + KNUCKLE + wheel("steered", "0 0 0", parent="knuckle"),
            {},
            "steered_joint is steered, or not",
        ),
        (
            CART.replace("left_joint", "port_joint"),
            CONTROLLED,
            "file names left_joint, which .* does not have",
        ),
    ],
)
def test_wheels_in_other_arrangements_are_asked_for(make, urdf, more, why):
    written = make(urdf, **more)
    assert written.status == 0
    problem = f"remark: driven wheels not identified: .*{why}"
    assert re.search(problem, written.output), written.output
    missing_fields = {
        "base.drive",
        "base.wheel_radius",
        "base.track",
        "base.axle_height",
        "body.size",
        "body.bottom",
    }
    assert missing_fields <= set(asked(written.output))
    # An empty section of YAML is None.
    assert "drive" not in (written.values["base"] or {})


def test_wheels_with_a_missing_mesh_have_a_track_and_no_size(make):
    cart_with_meshes = CART.replace(
        '<cylinder radius=".05" length=".02"/>', '<mesh filename="package://far/w.stl"/>'
    )
    written = make(cart_with_meshes)
    base = written.values["base"]
    assert base["drive"] == "two_wheel"
    assert base["track"] == 0.24
    assert "wheel_radius" not in base
    assert {"base.wheel_radius", "base.wheel_width"} <= set(asked(written.output))


def test_the_outline_is_that_of_fixed_shapes_above_the_axles(make):
    # A sticker on the ground and an arm, each one metre wide, are no part of the outline.
    sticker = link("mark", '<box size="1 1 .001"/>') + joint("mark", "0 0 -.05")
    arm_link = link("arm", '<box size="1 .1 .1"/>')
    arm_joint = joint("arm", "0 0 .2", kind="revolute", axis="0 0 1", more=LIMIT)
    written = make(CART + sticker + arm_link + arm_joint)
    assert written.values["body"]["size"] == [0.3, 0.2, 0.16]
    assert written.values["body"]["bottom"] == 0.06
    assert "the outline excludes moving links: roller, arm" in written.output


# With it, the laser alone has a shape.
BARE = link("base_link")


@pytest.mark.parametrize(
    ("hull", "why"),
    [
        (
            HULL.replace('<box size=".3 .2 .1"/>', '<mesh filename="package://far/hull.stl"/>'),
            "package://far/hull.stl",
        ),
        (BARE, "narrower than half the track"),
    ],
    ids=["a lost mesh", "a laser alone"],
)
def test_an_implausible_outline_is_asked_for_with_the_footprint_as_proposal(
    make, tmp_path, hull, why
):
    written = make(CART.replace(HULL, hull))
    assert re.search(f"outline not identified: .*{why}", written.output)
    assert written.values["body"] == {"centre": [-0.05, 0.0]}
    assert "  # size: [0.3, 0.26]" in (tmp_path / "my_robot/robot.yaml").read_text()


def test_shapes_down_to_the_ground_are_proposed_as_the_outline(make, tmp_path):
    # The hull stands on the ground (z = 0), and the scanner ends .22 m above it.
    written = make(CART.replace(HULL, HULL.replace("-.05 0 .06", "-.05 0 0")))
    assert "outline not identified: the fixed collision shapes reach down to the" in written.output
    assert "the outline excludes moving links: roller\n" in written.output
    assert written.values["body"] == {"centre": [-0.05, 0.0]}
    # The body's box ends 5 mm above the ground, on which it would rub.
    text = (tmp_path / "my_robot/robot.yaml").read_text()
    assert "  # size: [0.3, 0.2, 0.215] " in text
    assert "  # bottom: 0.005 " in text


MASSLESS_WHEELS = re.sub("<inertial>.*?</inertial>", "", WHEELS)
MASSLESS_HULL = re.sub("<inertial>.*?</inertial>", "", HULL)


@pytest.mark.parametrize(
    ("urdf", "proposals"),
    [
        # The body has 5 kg, the scanner .8 kg, the caster's roller .2 kg.
        (CART, {"wheel_mass": "0.4", "mass": "6.0"}),
        # The body's own mass is one, even if the wheels have none.
        (CART.replace(WHEELS, MASSLESS_WHEELS), {"mass": "6.0"}),
        # A mass of the laser and the caster alone is none.
        (CART.replace(WHEELS, MASSLESS_WHEELS).replace(HULL, MASSLESS_HULL), {}),
        # A link without a shape may have the body's mass, as that of a Husky.
        (
            CART.replace(HULL, MASSLESS_HULL)
            + link("inertial_link", mass=46.0)
            + joint("inertial_link", "0 0 0"),
            {"wheel_mass": "0.4", "mass": "47.0"},
        ),
        # Placeholders
        (CART.replace('"0.4"', '"1e-6"'), {"mass": "6.0"}),
    ],
    ids=["all", "wheels without", "a laser alone", "a link for the mass", "placeholders"],
)
def test_masses_of_the_urdf_are_proposed_unless_they_are_of_some_parts_alone(
    make, tmp_path, urdf, proposals
):
    printed = make(urdf).output
    text = (tmp_path / "my_robot/robot.yaml").read_text()
    assert dict(re.findall(r"^  # (mass|wheel_mass): (\S+) ", text, re.MULTILINE)) == proposals
    told = re.findall(r"mass\b.* in the URDF\b.*: (\S+)\n", printed)
    assert told == list(proposals.values())


def test_a_collada_mesh_has_its_own_unit(make, tmp_path):
    box_mesh = trimesh.creation.box((300, 200, 100)).export(file_type="dae").decode()
    in_millimetres = '<unit name="mm" meter="0.001"/></asset>'
    (tmp_path / "hull.dae").write_text(box_mesh.replace("</asset>", in_millimetres))
    written = make(CART.replace('<box size=".3 .2 .1"/>', '<mesh filename="hull.dae"/>'))
    assert written.values["body"]["size"] == pytest.approx([0.3, 0.2, 0.16])


# Second laser, upside down and turned
REAR_LASER = link("rear") + joint("rear", "-.2 0 .15", turn="3.14159265 0 0.5")
REAR_LASER += RAYS.replace("scanner", "rear")


def test_a_laser_that_no_file_names_is_asked_for(make):
    written = make(CART + REAR_LASER)
    assert (written.values["laser"] or {}) == {}
    remedy = "no file names it; give it with --laser LINK (scanner, rear)\n"
    assert f"laser not identified: {remedy}" in written.output
    assert {"laser.frame", "laser.pose", "laser.beams"} <= set(asked(written.output))


def test_a_word_in_the_place_of_a_sensor_value_is_asked_for(make):
    written = make(CART.replace("<samples>361</samples>", "<samples>many</samples>"))
    assert "laser.beams" in asked(written.output), written.output
    assert written.values["laser"]["rate"] == 20.0


def test_links_with_names_of_lasers_are_choices_without_ray_sensors(make):
    written = make(CART.replace(RAYS, ""))
    assert "give it with --laser LINK (scanner)\n" in written.output
    misspelt = make(CART, "--laser", "mast")
    assert "has no link mast: give one of its links (scanner)\n" in misspelt.output


@pytest.mark.parametrize("by", ["option", "sensor_frame"])
def test_a_laser_upside_down(make, by):
    if by == "option":
        written = make(CART + REAR_LASER, "--laser", "rear")
    else:
        common = COMMON.replace("topic: scan,", "topic: scan, sensor_frame: rear,")
        written = make(CART + REAR_LASER, files={"common.yaml": common})
    laser = written.values["laser"]
    assert laser["pose"] == [-0.2, 0.0, 0.5], written.output
    # Seen from above, its beams are in reverse.
    assert laser["first_angle"] == -1.4
    assert laser["last_angle"] == 1.5


def test_a_frame_of_the_laser_that_the_urdf_lacks_is_asked_for(make):
    common = COMMON.replace("topic: scan,", "topic: scan, sensor_frame: mast,")
    written = make(CART, files={"common.yaml": common})
    assert written.values["laser"] == {"frame": "mast"}
    assert "has no link mast, the sensor_frame of the costmaps" in written.output


UNREADABLE = r"check_urdf \(Debian: liburdfdom-tools\) finds the error"
# The remedy if a file is not what roslaunch loads
DUMP = "give the output of roslaunch --dump-params PACKAGE FILE.launch"
# A mistake puts another file in the place of the local planner's.
NO_PLANNER = PLACES[:-1]
HOURGLASS_END = "[0.1, -0.13], [0.1, 0.13]"  # the last two corners of the footprint, swapped


@pytest.mark.parametrize(
    ("urdf", "more", "line"),
    [
        (
            '<link name="$(arg part)"/>',
            {"name": "a.xacro"},
            "xacro fails: .*part.*; give arguments as NAME:=V",
        ),
        ("<link", {}, rf"cannot be read \(line 1, column 26\); {UNREADABLE}"),
        (CART.replace('size=".3 .2 .1"', 'size=".3 .2 wide"'), {}, UNREADABLE),
        ('<link name="plate"><collision/></link>', {}, UNREADABLE),
        (
            CART.replace("base_footprint", "foot"),
            {},
            "no link base_footprint, the robot_base_frame of .*: add it",
        ),
        (
            CART,
            {"places": [*NO_PLANNER, "common.yaml"]},
            "robot_base_frame is no parameter of move_base itself: give",
        ),
        (
            CART,
            {"files": {"dwa.yaml": "sim_time: 1.5\n"}},
            r"sim_time is no .*\(\S*dwa.yaml:TrajectoryPlannerROS and \S*dwa.yaml:DWA",
        ),
        (
            CART,
            {"files": {"dwa.yaml": "me: {DWAPlannerROS: {sim_time: 1.5}}\n"}},
            "me/DWA.* is one level too deep",
        ),
        (
            CART,
            {"files": {"common.yaml": COMMON.replace("[0.1, 0.13], [0.1, -0.13]", HOURGLASS_END)}},
            "costmap/footprint is .* cross each other: give the corners in their order around",
        ),
        # Nobody has typed a world_scale, which follows from the footprint.
        (
            CART,
            {"files": {"common.yaml": COMMON.replace("0.13", "13").replace("0.", "")}},
            "padded footprint of the files is 28 m wide: give footprint, robot_radius and .*",
        ),
        (
            CART,
            {"places": ["dwa.yaml"]},
            "have no local_costmap: give all files that the launch file loads",
        ),
        (CART, {"places": [*PLACES, "none.yaml"]}, "none.yaml: cannot be read"),
        (
            CART,
            {"files": {"dwa.yaml": "base_local_planner: teb/Teb\n"}},
            "base_local_planner is teb/Teb",
        ),
        (
            CART,
            {"files": {"local.yaml": "global_frame: $(arg prefix)odom\n"}},
            rf"local.yaml: global_frame is '\$\(arg prefix\)odom', which only roslaunch .*: {DUMP}",
        ),
        (
            CART,
            {
                "files": {"control.yaml": CONTROLLER.replace("right_joint", "$(env SIDE)")},
                "places": CONTROLLED["places"],
            },
            rf"control.yaml: right_wheel is '\$\(env SIDE\)', which only roslaunch .*: {DUMP}",
        ),
        (
            CART,
            {"files": {"dwa.yaml": "<!-- of -->\n<launch>\n</launch>"}},
            f"dwa.yaml is a launch file: {DUMP}",
        ),
        (CART, {"files": {"dwa.yaml": "<robot/>"}}, f"dwa.yaml is a URDF: {DUMP}"),
        (
            CART,
            {"files": {"dwa.yaml": "PARAMETERS\n * /move_base/footprint: [[0.2, 0.2...\n"}},
            f"dwa.yaml is the list that roslaunch prints, which cuts off .*: {DUMP}",
        ),
        (
            "",
            {"whole": "<launch>{}</launch>"},
            "crate.urdf is a launch file: give the URDF or xacro file of the whole robot",
        ),
        ("", {"whole": "plugins: []{}"}, "crate.urdf is no URDF: give the URDF or xacro"),
        (
            CART + link("pack") + link("lamp") + joint("lamp", "0 0 0", "pack"),
            {},
            "no joint connects pack, lamp to base_footprint: correct the joints in .*",
        ),
        (link("pack") + CART, {}, "no joint connects pack to base_footprint: correct .*"),
        (CART + joint("pack", "0 0 0"), {}, UNREADABLE),
        (CART + joint("left", "0 0 0", "swivel"), {}, UNREADABLE),
        (CART + CASTER, {}, UNREADABLE),
        (CART + joint("base_footprint", "0 0 0", "roller"), {}, "no joint connects .*: correct"),
    ],
)
def test_an_ordinary_mistake_is_one_line(make, tmp_path, urdf, more, line):
    written = make(urdf, **more)
    assert written.status == 1
    assert re.fullmatch(rf"\./applr robot: .*{line}.*\n", written.output), written.output
    assert not (tmp_path / "my_robot").exists()


@pytest.mark.parametrize(
    ("urdf", "problem"),
    [
        ('<xacro:include filename="{pipe}"/>', "it has not ended after 2 s"),
        ('<link name="${{9**9**9}}"/>', "it has not ended after 2 s"),
        ("<link name=\"${{'a' * 3 * 10**9}}\"/>", "when evaluating expression ''a' "),
    ],
)
def test_a_xacro_file_that_does_not_end_or_takes_all_memory_is_one_line(
    make, tmp_path, monkeypatch, urdf, problem
):
    monkeypatch.setattr(urdf_reader, "EXPANSION_S", 2.0)
    pipe = tmp_path / "pipe.xacro"
    os.mkfifo(pipe)
    written = make(urdf.format(pipe=pipe), name="crate.xacro", whole=WHOLE)
    assert written.status == 1
    line = rf"\./applr robot: \S*crate.xacro: xacro fails: .*{problem}.*; give arguments .*\n"
    assert re.fullmatch(line, written.output), written.output


def test_xacro_tags_count_in_a_urdf_but_not_in_comments(make):
    macro = "<link name='${part}'/>"
    assert "has xacro tags" in make(CART + macro).output
    assert make(f"{CART}<!-- {macro} -->", name="a.xacro").status == 0


# The pack with the scanner is mounted only if a variable is set, as on a robot of RoverRobotics.
MOUNT = joint("scanner", ".05 0 .15")
PACK = '<xacro:if value="$(optenv CRATE_PACK 0)">{}</xacro:if>'.format(MOUNT)
WHOLE = "<robot name='crate' xmlns:xacro='http://www.ros.org/wiki/xacro'>{}</robot>"


@pytest.mark.parametrize("value", [None, "0"])
def test_a_variable_that_mounts_a_part_is_named_with_its_value(make, monkeypatch, value):
    urdf = CART.replace(MOUNT, PACK)
    assert urdf != CART
    monkeypatch.delenv("CRATE_PACK", raising=False)
    if value is not None:
        monkeypatch.setenv("CRATE_PACK", value)
    written = make(urdf, name="crate.xacro", whole=WHOLE)
    problem = "crate.xacro: no joint connects scanner to base_footprint: set the environment"
    assert f"{problem} variable CRATE_PACK (now {value or 'not set'}) as on" in written.output
    assert written.output.count("\n") == 1

    monkeypatch.setenv("CRATE_PACK", "1")
    assert make(urdf, name="crate.xacro", whole=WHOLE).status == 0


def test_a_variable_that_adds_the_laser_is_named_with_its_value(make, monkeypatch):
    laser = f'<xacro:if value="$(optenv CRATE_LASER 0)">{SCANNER}{RAYS}</xacro:if>'
    urdf = CART.replace(RAYS, "").replace(SCANNER, laser)
    monkeypatch.delenv("CRATE_LASER", raising=False)
    written = make(urdf, name="crate.xacro", whole=WHOLE)
    assert (
        "give it with --laser LINK, or set CRATE_LASER (now not set) as on the robot\n"
        in written.output
    )


def test_colours_of_a_urdf_are_not_read(make):
    red = "<visual><geometry><box size='1 1 1'/></geometry>"
    red += "<material name='red'><color rgba='300 0 0 1'/></material></visual></link>"
    assert make(CART.replace("</link>", red, 1)).status == 0
    assert make(CART.replace(HULL, HULL.replace("</link>", red))).status == 0


# As on a Fetch: only the limits that differ from the controller's own
BASE_CONTROLLER = """\
arm_controller: {follow_joint_trajectory: {joints: [shoulder]}}
base_controller:
  type: robot_controllers/DiffDriveBaseController
  l_wheel_joint: left_joint
  r_wheel_joint: right_joint
  max_velocity_x: 0.9
  max_acceleration_x: 0.7
"""


def test_limits_of_a_controller_of_robot_controllers_are_used(make):
    more = {"files": {"control.yaml": BASE_CONTROLLER}, "places": [*PLACES, "control.yaml"]}
    written = make(CART, **more)
    base = written.values["base"]
    assert "left_joint, right_joint, according to the controller's file" in written.output
    assert base["max_speed"] == 0.9
    assert base["max_acceleration"] == 0.7
    # The controller's defaults (diff_drive_base.cpp)
    assert base["max_yaw_rate"] == 4.5
    assert base["max_yaw_acceleration"] == 3.0
    assert base["command_timeout"] == 0.25
    assert written.values["monitor"] == {"deceleration": 0.7, "yaw_deceleration": 3.0}
    assert "remark: not used: arm_controller in control.yaml\n" in written.output


def test_what_a_file_has_for_other_nodes_is_named(make):
    dump = {
        "/rosdistro": "noetic",
        "/two/amcl/min_particles": 500,
        "/two/move_base/local_costmap": {**yaml.safe_load(COMMON), **yaml.safe_load(LOCAL)},
        "/two/move_base/global_costmap": yaml.safe_load(COMMON),
        "/two/move_base/GlobalPlanner/use_dijkstra": True,
    }
    files = {"dump.yaml": yaml.safe_dump(dump), "more.yaml": "gripper: {effort: 3}\nspeed: 2\n"}
    written = make(CART, files=files, places=["dump.yaml", "more.yaml", "dwa.yaml"])
    unused = "rosdistro, two/amcl, GlobalPlanner in dump.yaml; gripper, speed in more.yaml"
    assert f"remark: not used: {unused}\n" in written.output


def test_a_missing_link_is_refused(make):
    misspelt = make(CART, "--laser", "scaner")
    assert misspelt.status == 1
    assert "has no link scaner: did you mean scanner?\n" in misspelt.output


def test_the_command_may_be_repeated_until_something_is_filled_in(make, tmp_path):
    folder = tmp_path / "my_robot"
    # Two lasers: the first run asks which of them it is. The second run also has a controller.
    assert make(CART + REAR_LASER).status == 0
    repeated = make(CART + REAR_LASER, "--laser", "rear", **CONTROLLED)
    assert repeated.status == 0, repeated.output
    assert repeated.values["laser"]["frame"] == "rear"
    assert repeated.values["base"]["max_speed"] == 0.6

    # When: a value is filled in
    fill(folder, casters="[[-0.15, 0.0]]")
    filled_text = (folder / "robot.yaml").read_text()
    refused = make(CART + REAR_LASER, "--laser", "rear", **CONTROLLED)
    assert refused.status == 1
    assert refused.output.count("\n") == 1
    filled_in = "base.max_yaw_rate, base.wheel_mass, base.casters, body.mass, which this command"
    assert f"{folder}/robot.yaml has {filled_in} would not write: move" in refused.output
    assert (folder / "robot.yaml").read_text() == filled_text


def test_a_copy_that_its_owner_has_changed_is_not_overwritten(make, tmp_path):
    assert make(CART).status == 0
    copy = tmp_path / "my_robot/dwa.yaml"
    copy.write_text(copy.read_text() + "# slower\n")
    refused = make(CART)
    assert refused.status == 1
    assert f"{copy} differs from the file that was given: move it away" in refused.output
    assert copy.read_text().endswith("# slower\n")


def test_a_round_body_is_no_box(make, tmp_path):
    make(CART)
    folder = tmp_path / "my_robot"
    fill(folder, casters="[[-0.15, 0.0]]")
    robot_yaml = folder / "robot.yaml"
    round_size = "size: [0.3, 0.3, 0.16]\n  round: true"
    robot_yaml.write_text(re.sub("size: .*", round_size, robot_yaml.read_text()))
    robot = robots.load(str(folder))

    # Planner, monitor and RViz have a circle of 0.15 m radius instead of a square.
    outline = robots.geometry.corners(robot) - robot.body.centre
    parts = np.array(robots.geometry.parts(robot))
    assert parts[:4, 2:].max(axis=0).tolist() == pytest.approx([0.15, 0.15])
    assert np.hypot(*outline[:16].T).max() == pytest.approx(0.15, rel=0.02)
    assert outline[:, 0].max() == pytest.approx(0.15)
    assert len(MonitorSettings.of(robot).body) == 24
    assert 'cylinder radius="0.15"' in urdf_of(robot)
