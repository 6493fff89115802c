"""Tests of ./applr robot, which writes a robot's folder from its URDF or xacro file and its
parameter files.

owners/ contains URDFs in the style of several makers, with the dimensions of the included robots.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots.rviz_model import urdf as urdf_of
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
    place = f'<origin xyz="{at}" rpy="{turn}"/><axis xyz="{axis}"/>'
    return f'<joint name="{child}_joint" type="{kind}">{links}{place}{more}</joint>'


def wheel(name, at, axis="0 0 1", turn="-1.5707963 0 0", radius=".05", kind="continuous", **more):
    """Return a wheel with its joint: width .02 m, mass .4 kg."""
    shape = f'<cylinder radius="{radius}" length=".02"/>'
    return link(name, shape, 0.4) + joint(name, at, kind=kind, axis=axis, turn=turn, **more)


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
CONTROLLED = {"files": {"control.yaml": CONTROLLER}, "places": [*PLACES, "control.yaml"]}


def run(urdf, parameters, out, capsys, words=()):
    """Write the robot's folder, and return (exit status, output, values of robot.yaml)."""
    files = list(map(str, parameters))
    status = new_robot.main([str(urdf), *words, "--out", str(out), "--parameters", *files])
    output = capsys.readouterr()
    robot_yaml = out / "robot.yaml"
    values = yaml.safe_load(robot_yaml.read_text()) if robot_yaml.exists() else {}
    return status, output.out + output.err, values


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
        for path, text in texts.items():
            (tmp_path / path).write_text(text)
        parameter_files = [tmp_path / place for place in places]
        return run(tmp_path / name, parameter_files, tmp_path / "my_robot", capsys, words)

    return write


def fill(folder, **values):
    """Fill in values in robot.yaml, and accept the proposals for all other fields."""
    path = folder / "robot.yaml"
    text = path.read_text()
    filled = {"mass": 6.0, "wheel_mass": 0.4, **values}
    for name, value in filled.items():
        text = re.sub(rf"^  # {name}: .*", f"  {name}: {value}", text, flags=re.MULTILINE)
    text = re.sub(r"^  # (\w+: \S+)", r"  \1", text, flags=re.MULTILINE)
    path.write_text(text)
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
        [*LIMITS, "base.wheel_mass", "base.casters", "body.mass", *BRAKING],
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
        ["base.wheel_mass", "body.mass"],
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
        [*LIMITS, "base.wheel_mass", "body.mass", *(f"laser.{name}" for name in SCAN), *BRAKING],
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
    words, parameters, wanted = MAKERS[name]
    (urdf,) = (OWNERS / f"{name}_description/urdf").iterdir()
    # An absolute path, such as that of the controller's file, replaces the folder.
    files = [FOLDERS[name] / file for file in parameters]
    status, output, values = run(urdf, files, tmp_path, capsys, words)
    assert status == 0, output
    assert asked(output) == wanted
    included = yaml.safe_load((FOLDERS[name] / "robot.yaml").read_text())
    for section in ("base", "body", "laser"):
        for key, value in values[section].items():
            # A URDF has the noise of its simulation. Not all included robots give the other two.
            if key not in ("noise", "centre", "bottom"):
                assert value == pytest.approx(included[section][key], abs=2e-3), key
    assert values["world_scale"] == included["world_scale"]
    fill(tmp_path, **FILLED)
    assert check_robot.main([str(tmp_path)]) == 0, capsys.readouterr()


def test_a_dump_of_roslaunch_is_one_parameter_file(make):
    common = yaml.safe_load(COMMON)
    local = {**common, **yaml.safe_load(LOCAL)}
    flat = {
        "/rosdistro": "noetic",
        "/two/crate/left_wheel": "left_joint",
        "/two/crate/right_wheel": "right_joint",
        "/two/move_base/base_local_planner": "dwa_local_planner/DWAPlannerROS",
    }
    for name, value in local.items():
        flat[f"/two/move_base/local_costmap/{name}"] = value
    for name, value in common.items():
        flat[f"/two/move_base/global_costmap/{name}"] = value
    dump = yaml.safe_dump(flat)

    status, output, values = make(CART, files={"dump.yaml": dump}, places=["dump.yaml"])

    assert status == 0, output
    assert "left_joint, right_joint, according to the controller's file" in output
    assert values["move_base"]["files"] == [{"file": "dump.yaml"}]
    assert values["frames"]["odom"] == "odom_comb"
    assert values["topics"]["scan"] == "scan"


def test_the_folder_of_a_cart_has_the_values_of_its_files(make, tmp_path, capsys):
    status, output, values = make(CART)
    assert status == 0, output
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
    assert asked(output) == [*LIMITS, "base.wheel_mass", "base.casters", "body.mass", *BRAKING]
    text = (tmp_path / "my_robot/robot.yaml").read_text()
    proposal = r"\[m/s\] largest speed .*; proposal: the planner's max_vel_trans\n"
    assert re.search(rf"  # max_speed: 0.45 +# {proposal}", text)
    assert check_robot.main([str(tmp_path / "my_robot")]) == 1
    assert "base.max_speed is missing" in capsys.readouterr().err
    fill(tmp_path / "my_robot", casters="[[-0.15, 0.0]]")
    assert check_robot.main([str(tmp_path / "my_robot")]) == 0, capsys.readouterr()
    robot = robots.load(str(tmp_path / "my_robot"))
    assert robot.parameters()["DWAPlannerROS"]["max_vel_theta"] == pytest.approx(np.pi / 2)
    for with_map, names, sources in (
        (True, ["map", "seen", "margin"], "bumper scan"),
        (False, ["seen", "margin"], "scan"),
    ):
        parameters = robot.parameters(with_map)
        plugins = parameters["global_costmap"]["plugins"]
        assert [layer["name"] for layer in plugins] == names
        assert parameters["local_costmap"]["seen"]["observation_sources"] == sources
        assert parameters["NavfnROS"]["allow_unknown"] is not with_map
    # Without a map, the global costmap is a square around the start.
    bare = robot.parameters()["global_costmap"]
    assert bare["global_frame"] == "odom_comb"
    assert bare["width"] == 23
    assert bare["origin_x"] == -11.5
    assert "only the laser scan, without bumps: correct it before" in output


@pytest.mark.parametrize("frame", ["odom", "map"])
def test_both_costmaps_may_be_in_one_frame_of_any_name(make, frame):
    # Without a static layer, the frame is that of the odometry.
    common = COMMON + "global_frame: any\n"
    if frame == "odom":
        common = re.sub("  - {name: map.*\n", "", common)
    files = {"common.yaml": common, "local.yaml": LOCAL.replace("global_frame: odom_comb, ", "")}
    assert make(CART, files=files)[2]["frames"] == {"base": "base_footprint", frame: "any"}


LIMIT = '<limit lower="-.5" upper=".5" effort="1" velocity="1"/>'
IDLE = wheel("idle_left", "-.15 .05 0") + wheel("idle_right", "-.15 -.05 0")
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
    _, output, values = make(urdf, **more)
    wheels = "(left|right)_joint, (left|right)_joint"
    assert re.search(f"the driven wheels are {wheels}, according to {by}", output)
    base = values["base"]
    assert base["drive"] == "two_wheel"
    assert base["track"] == 0.24
    assert base["wheel_radius"] == 0.05
    if more:
        assert base["max_speed"] == 0.6
        assert base["max_yaw_acceleration"] == 25.0
        assert base["command_timeout"] == 0.5
        assert "base.max_yaw_rate" in asked(output)
        for entry in values["move_base"]["files"]:
            assert entry["file"] != "control.yaml"
        assert values["monitor"] == {"deceleration": 1.5, "yaw_deceleration": 12.0}


PLANAR = "<gazebo><plugin name='p' filename='planar_move.so'/></gazebo>"
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
    status, output, values = make(urdf, **more)
    assert status == 0
    assert re.search(f"remark: driven wheels not identified: .*{why}", output), output
    missing = {
        "base.drive",
        "base.wheel_radius",
        "base.track",
        "base.axle_height",
        "body.size",
        "body.bottom",
    }
    assert missing <= set(asked(output))
    assert "drive" not in (values["base"] or {})


def test_wheels_with_a_missing_mesh_have_a_track_and_no_size(make):
    bare = CART.replace(
        '<cylinder radius=".05" length=".02"/>', '<mesh filename="package://far/w.stl"/>'
    )
    _, output, values = make(bare)
    base = values["base"]
    assert base["drive"] == "two_wheel"
    assert base["track"] == 0.24
    assert "wheel_radius" not in base
    assert {"base.wheel_radius", "base.wheel_width"} <= set(asked(output))


def test_the_outline_is_that_of_fixed_shapes_above_the_axles(make):
    # A sticker on the ground and an arm, each one metre wide, are no part of the outline.
    mark = link("mark", '<box size="1 1 .001"/>') + joint("mark", "0 0 -.05")
    arm = link("arm", '<box size="1 .1 .1"/>') + joint(
        "arm", "0 0 .2", kind="revolute", axis="0 0 1", more=LIMIT
    )
    _, output, values = make(CART + mark + arm)
    assert values["body"]["size"] == [0.3, 0.2, 0.16]
    assert values["body"]["bottom"] == 0.06
    assert "the outline excludes moving links: roller, arm" in output


BARE = link("base_link")


@pytest.mark.parametrize(
    ("hull", "why"),
    [
        (
            HULL.replace('<box size=".3 .2 .1"/>', '<mesh filename="package://far/hull.stl"/>'),
            "package://far/hull.stl",
        ),
        (HULL.replace("-.05 0 .06", "-.05 0 0"), "reach down to the ground"),
        (BARE, "narrower than half the track"),
    ],
    ids=["a lost mesh", "on the ground", "a laser alone"],
)
def test_an_implausible_outline_is_asked_for_with_the_footprint_as_proposal(
    make, tmp_path, hull, why
):
    _, output, values = make(CART.replace(HULL, hull))
    assert re.search(f"outline not identified: .*{why}", output)
    assert values["body"] == {"centre": [-0.05, 0.0]}
    assert "  # size: [0.3, 0.26]" in (tmp_path / "my_robot/robot.yaml").read_text()


def test_a_collada_mesh_has_its_own_unit(make, tmp_path):
    mesh = trimesh.creation.box((300, 200, 100)).export(file_type="dae").decode()
    (tmp_path / "hull.dae").write_text(
        mesh.replace("</asset>", '<unit name="mm" meter="0.001"/></asset>')
    )
    _, _, values = make(CART.replace('<box size=".3 .2 .1"/>', '<mesh filename="hull.dae"/>'))
    assert values["body"]["size"] == pytest.approx([0.3, 0.2, 0.16])


# Second laser, upside down and turned
REAR_LASER = link("rear") + joint("rear", "-.2 0 .15", turn="3.14159265 0 0.5")
REAR_LASER += RAYS.replace("scanner", "rear")


def test_a_laser_that_no_file_names_is_asked_for(make):
    _, output, values = make(CART + REAR_LASER)
    assert (values["laser"] or {}) == {}
    remedy = "no file names it; give it with --laser LINK; these links have ray"
    assert f"laser not identified: {remedy}" in output
    assert {"laser.frame", "laser.pose", "laser.beams"} <= set(asked(output))


@pytest.mark.parametrize("by", ["option", "sensor_frame"])
def test_a_laser_upside_down(make, by):
    if by == "option":
        _, output, values = make(CART + REAR_LASER, "--laser", "rear")
    else:
        common = COMMON.replace("topic: scan,", "topic: scan, sensor_frame: rear,")
        _, output, values = make(CART + REAR_LASER, files={"common.yaml": common})
    laser = values["laser"]
    assert laser["pose"] == [-0.2, 0.0, 0.5], output
    # Seen from above, its beams are in reverse.
    assert laser["first_angle"] == -1.4
    assert laser["last_angle"] == 1.5


def test_a_frame_of_the_laser_that_the_urdf_lacks_is_asked_for(make):
    named = {"common.yaml": COMMON.replace("topic: scan,", "topic: scan, sensor_frame: mast,")}
    _, output, values = make(CART, files=named)
    assert values["laser"] == {"frame": "mast"}
    assert "has no link mast, the sensor_frame of the costmaps" in output


NO_PLANNER = PLACES[:-1]


@pytest.mark.parametrize(
    ("urdf", "more", "line"),
    [
        (
            '<link name="$(arg part)"/>',
            {"name": "a.xacro"},
            "xacro fails: .*part.*; give arguments as NAME:=V",
        ),
        ("<link", {}, "is no valid URDF: ParseError.*; run check_urdf"),
        ('<link name="plate"><collision/></link>', {}, "is no valid URDF: .*; run check_urdf"),
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
            {"places": ["dwa.yaml"]},
            "have no local_costmap: give all files that the launch file loads",
        ),
        (CART, {"places": [*PLACES, "none.yaml"]}, "none.yaml: cannot be read"),
        (
            CART,
            {"files": {"dwa.yaml": "base_local_planner: teb/Teb\n"}},
            "base_local_planner is teb/Teb",
        ),
    ],
)
def test_an_ordinary_mistake_is_one_line(make, tmp_path, urdf, more, line):
    status, output, _ = make(urdf, **more)
    assert status == 1
    assert re.fullmatch(rf"\./applr robot: .*{line}.*\n", output), output
    assert not (tmp_path / "my_robot").exists()


def test_xacro_tags_count_in_a_urdf_but_not_in_comments(make):
    macro = "<link name='${part}'/>"
    assert "has xacro tags" in make(CART + macro)[1]
    assert make(f"{CART}<!-- {macro} -->", name="a.xacro")[0] == 0


def test_a_missing_link_and_an_existing_folder_are_refused(make):
    status, output, _ = make(CART, "--laser", "scaner")
    assert status == 1
    assert "has no link scaner: did you mean scanner?\n" in output

    status, _, _ = make(CART)
    assert status == 0
    status, output, _ = make(CART)
    assert status == 1
    assert output.count("\n") == 1
    assert "robot.yaml already exists" in output


def test_a_round_body_is_no_box(make, tmp_path):
    make(CART)
    fill(tmp_path / "my_robot", casters="[[-0.15, 0.0]]")
    file = tmp_path / "my_robot/robot.yaml"
    file.write_text(re.sub("size: .*", "size: [0.3, 0.3, 0.16]\n  round: true", file.read_text()))
    robot = robots.load(str(tmp_path / "my_robot"))

    # Planner, monitor and RViz have a circle of 0.15 m radius instead of a square.
    ends = robots.geometry.corners(robot) - robot.body.centre
    parts = np.array(robots.geometry.parts(robot))
    assert parts[:4, 2:].max(axis=0).tolist() == pytest.approx([0.15, 0.15])
    assert np.hypot(*ends[:16].T).max() == pytest.approx(0.15, rel=0.02)
    assert ends[:, 0].max() == pytest.approx(0.15)
    assert len(MonitorSettings.of(robot).body) == 24
    assert 'cylinder radius="0.15"' in urdf_of(robot)
