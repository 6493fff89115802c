"""A robot's folder, written from its URDF or xacro file and its parameter files."""

import errno
import os
import re
import time
import zipfile
from textwrap import indent
from xml.sax.saxutils import escape

import numpy as np
import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots.learned import default_space
from applr_ros1.robots.owner.expand import LIMITS, expand
from applr_ros1.robots.owner.urdf import UrdfFile
from applr_ros1.robots.rviz_model import urdf as urdf_of
from training import check_robot, new_robot

pytest.importorskip("yourdfpy")
trimesh = pytest.importorskip("trimesh")

HEAD = '<robot name="crate" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def link(name, shape="", mass=0.0, at="0 0 0", turn="0 0 0"):
    """A link with one collision shape and the mass of a point there, each of its moments .01."""
    origin = f'<origin xyz="{at}" rpy="{turn}"/>'
    moments = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial>{origin}<mass value="{mass}"/>{moments}</inertial>' if mass else ""
    collision = f"<collision>{origin}<geometry>{shape}</geometry></collision>" if shape else ""
    return f'<link name="{name}">{inertial}{collision}</link>'


def joint(child, at, parent="base_link", kind="fixed", axis="0 1 0", turn="0 0 0"):
    return (
        f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{turn}"/><axis xyz="{axis}"/></joint>'
    )


def wheel(name, at, axis="0 0 1", turn="-1.5707963 0 0", **more):
    """A wheel of radius .05 m and width .02 m, which weighs .4 kg."""
    shape = '<cylinder radius=".05" length=".02"/>'
    return link(name, shape, 0.4) + joint(name, at, kind="continuous", axis=axis, turn=turn, **more)


RAYS = """<gazebo reference="scanner"><sensor name="rays" type="gpu_ray"><update_rate>20</update_rate><ray>
<scan><horizontal><samples>361</samples>
<resolution>2</resolution><min_angle>-1.5</min_angle><max_angle>$(arg reach)</max_angle></horizontal>
</scan><range><min>.1</min><max>8</max></range><noise><stddev>.005</stddev></noise></ray>
<plugin name="p" filename="p.so"><topicName>base_scan</topicName></plugin></sensor></gazebo>"""
TWO = (
    '<link name="base_footprint"/>'
    + joint("base_link", "0 0 .05", "base_footprint")
    + link("base_link", '<box size=".3 .2 .1"/>', 5.0, at="-.05 0 .06")
    + wheel("left", "0 .12 0")
    + wheel("right", "0 -.12 0")
    + link("swivel")
    + joint("swivel", "-.15 0 -.02", kind="continuous", axis="0 0 1")
    + link("roller", '<sphere radius=".03"/>', 0.2)
    + joint("roller", "0 0 0", "swivel", "continuous")
    + link("scanner", '<cylinder radius=".03" length=".04"/>', 0.8)
    + joint("scanner", ".05 0 .15")
)
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
PLANNER = """\
DWAPlannerROS:
  {max_vel_x: 0.4, max_vel_trans: 0.45, min_vel_y: 0.0, max_vel_y: 0.0, max_vel_theta: 1.5, acc_lim_x: 1.0,
   acc_lim_theta: 3.0, min_vel_theta: 0.1}
"""
AMCL = "min_particles: 100\n"
NAVFN = "NavfnROS: {allow_unknown: false}\n"
CONTROLLER = """\
crate_controller:
  cmd_vel_timeout: 0.25
  linear: {x: {has_velocity_limits: true, max_velocity: 0.6, has_acceleration_limits: true, max_acceleration: 1.5}}
  angular: {z: {has_velocity_limits: false, max_velocity: 9.0, has_acceleration_limits: true, max_acceleration: 25.0}}
"""


ONE_EACH = "".join(
    f"{side}_motor: {{type: velocity_controllers/JointVelocityController, joint: {side}_joint}}\n"
    for side in ("left", "right")
)
DIFF_DRIVE = "crate_controller: {left_wheel: [left_joint], right_wheel: right_joint}\n"


@pytest.fixture
def make(tmp_path, capsys):
    """Writes the files and the robot's folder: (exit status, what was printed, robot.yaml)."""

    def run(urdf, *words, head=HEAD, tail="", out="my_robot", **parameters):
        files = {"costmap_common.yaml": COMMON, "costmap_local.yaml": LOCAL, "dwa.yaml": PLANNER, **parameters}
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        (tmp_path / "crate.urdf").write_text(head + urdf + (tail or "</robot>" * (head == HEAD)))
        out = tmp_path / out
        arguments = [str(tmp_path / "crate.urdf"), *words, "--out", str(out), "--parameters"]
        status = new_robot.main([*arguments, *[str(tmp_path / name) for name in files]])
        said = capsys.readouterr()
        return status, said.out + said.err, out / "robot.yaml"

    return run


def fill(file):
    """Takes the proposals of what is asked for."""
    file.write_text(re.sub(r"^  # (\w+: \S+)", r"  \1", file.read_text(), flags=re.MULTILINE))


def test_costmaps_get_the_base_frame_that_no_parameter_file_names(make):
    chassis = ('<xacro:arg name="reach" default="1.5"/>' + TWO + RAYS).replace("base_link", "chassis")
    common = COMMON.replace("robot_base_frame: base_footprint\n", "")
    _, said, file = make(chassis, **{"costmap_common.yaml": common})
    fill(file)
    robot = robots.load(str(file.parent))
    for costmap in ("global_costmap", "local_costmap"):
        assert robot.parameters()[costmap]["robot_base_frame"] == robot.frames.base != "base_link", said


def test_two_wheels_and_a_caster(make, capsys):
    status, said, file = make('<xacro:arg name="reach" default="1.5"/>' + TWO + RAYS, "reach:=1.4")
    assert status == 0, said
    found = yaml.safe_load(file.read_text())
    assert found["base"] == {
        "drive": "two_wheel",
        "wheel_radius": 0.05,
        "wheel_width": 0.02,
        "track": 0.24,
        "axle_height": 0.05,
        "wheel_mass": 0.4,
        "wheel_inertia": [0.01, 0.01, 0.01],
        "casters": [[-0.15, 0.0]],
    }
    body = found["body"]
    assert (body["size"], body["centre"], body["bottom"]) == ([0.3, 0.2, 0.16], [-0.05, 0.0], 0.06)
    assert (body["mass"], body["com"]) == (6.0, [-0.04, 0.0, 0.11933])
    assert body["inertia"][2] == pytest.approx(3 * 0.01 + 5 * 0.01**2 + 0.2 * 0.11**2 + 0.8 * 0.09**2, rel=1e-4)
    laser = {"frame": "scanner", "pose": [0.05, 0.0, 0.0], "height": 0.2, "beams": 722, "first_angle": -1.5}
    laser.update(last_angle=1.4, range_min=0.1, range_max=8.0, rate=20.0, noise=0.005)
    assert found["laser"] == laser
    assert (found["topics"], found["frames"]) == ({"scan": "scan"}, {"base": "base_footprint", "odom": "odom_comb"})
    assert "refuses" not in said, said
    assert found["world_scale"] == pytest.approx(0.28 / 0.53, abs=1e-3)
    asked = re.findall(r"^  (\w+\.\w+) \[.*?([\d.]*)$", said, re.MULTILINE)
    assert dict(asked) == {
        "base.max_speed": "0.45",
        "base.max_yaw_rate": "1.5",
        "base.max_acceleration": "1.0",
        "base.max_yaw_acceleration": "3.0",
        "monitor.deceleration": "1.0",
        "monitor.yaw_deceleration": "3.0",
    }
    assert check_robot.main([str(file.parent)]) == 1
    assert "base.max_speed" in capsys.readouterr().err
    fill(file)
    robots.folder._read.cache_clear()
    assert check_robot.main([str(file.parent)]) == 0
    assert "DWAPlannerROS, 20 commands per second, with and without a map" in capsys.readouterr().out


def test_masses_and_casters_stand_as_far_from_the_wheels_as_in_the_urdf(make):
    ahead = TWO.replace('"0 .12 0"', '".1 .12 0"').replace('"0 -.12 0"', '".1 -.12 0"')
    _, said, file = make('<xacro:arg name="reach" default="1.5"/>' + ahead + RAYS)
    found = yaml.safe_load(file.read_text())
    assert "middle lies 0.100 m ahead of base_footprint" in said
    assert (found["base"]["casters"], found["body"]["com"]) == ([[-0.25, 0.0]], [-0.14, 0.0, 0.11933])
    assert found["body"]["centre"] == [-0.05, 0.0]


def test_parameter_files_below_the_names_at_which_move_base_reads_them(make):
    beside = "move_base: {" + NAVFN.strip() + "}\n"  # as a launch file loads it beside the node
    more = {"costmap_common.yaml": COMMON.replace("base_foot", "/base_foot"), "amcl.yaml": AMCL, "navfn.yaml": beside}
    _, said, file = make(TWO + RAYS.replace("$(arg reach)", "1.5"), **more)
    found = yaml.safe_load(file.read_text())["move_base"]
    assert [(entry["file"], entry.get("namespace", "")) for entry in found["files"]] == [
        ("costmap_common.yaml", "local_costmap"),
        ("costmap_common.yaml", "global_costmap"),
        ("costmap_local.yaml", "local_costmap"),
        ("dwa.yaml", ""),
        ("navfn.yaml", ""),
    ]
    assert "amcl.yaml is left out" in said
    assert "local_costmap/plugins has costmap_2d::VoxelLayer: an obstacle layer stands for it" in said
    assert "take nothing from bumps: " in said
    fill(file)
    robots.folder._read.cache_clear()
    robot = robots.load(str(file.parent))
    assert robot.local_planner == "DWAPlannerROS"
    layers = [[layer["name"] for layer in robot.parameters(at)["global_costmap"]["plugins"]] for at in (True, False)]
    assert layers == [["map", "seen", "margin"], ["seen", "margin"]]
    sources = [robot.parameters(at)["local_costmap"]["seen"]["observation_sources"] for at in (True, False)]
    assert sources == ["bumper scan", "scan"]
    assert [robot.parameters(at)["NavfnROS"]["allow_unknown"] for at in (True, False)] == [False, True]
    bare = robot.parameters()["global_costmap"]
    assert (bare["global_frame"], bare["width"], bare["origin_x"]) == ("odom_comb", 23, -11.5)


def test_four_wheels_on_rockers_a_mesh_and_the_limits_of_a_controller(make, tmp_path):
    package = tmp_path / "crate_description"
    (package / "meshes").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>of_the_crate</name></package>")
    trimesh.creation.box((400, 300, 100)).export(package / "meshes" / "body.stl")
    mesh = '<mesh filename="package://of_the_crate/meshes/body.stl" scale=".001 .001 .001"/>'
    urdf = link("base_link", mesh, 8.0, at="0 0 .1")
    for side, y in (("left", ".2"), ("right", "-.2")):
        urdf += link(side, '<box size=".2 .02 .02"/>') + joint(side, f"0 {y} 0", kind="revolute")
        urdf += wheel(side + "_front", ".15 0 0", parent=side) + wheel(side + "_rear", "-.13 0 0", parent=side)
    urdf += link("arm", '<box size="1 .1 .1"/>') + joint("arm", "0 0 .2", kind="revolute", axis="0 0 1")
    urdf += wheel("gripper", ".1 0 .3", parent="arm")  # turns as a wheel does, above the ground
    urdf += link("scanner") + joint("scanner", ".1 0 .2", turn="3.14159265 0 .5")
    rays = RAYS.replace("$(arg reach)", "1.2")
    deeper = "robot:\n" + indent(CONTROLLER, "  ")
    status, said, file = make(
        urdf + rays,
        **{"costmap_common.yaml": COMMON.replace("base_footprint", "base_link"), "control.yaml": deeper},
    )
    assert status == 0, said
    assert "crate.urdf and 4 parameter files\n" in said  # the controller's, too
    assert "leave out 1 values" in said
    assert "base.max_yaw_rate" in said
    fill(file)
    assert "outline: arm" in said
    assert "middle lies 0.010 m ahead" not in said
    robot = robots.load(str(file.parent))
    base = robot.base
    assert (base.drive, base.wheelbase, base.track, base.axle_height) == ("skid_steer", 0.28, 0.4, 0.0)
    assert (base.max_speed, base.max_yaw_acceleration, base.command_timeout) == (0.6, 25.0, 0.25)
    assert (robot.body.size, robot.body.bottom) == ((0.4, 0.42, 0.16), -0.01)
    assert (robot.laser.pose[2], robot.laser.first_angle, robot.laser.last_angle) == (0.5, -1.2, 1.5)
    assert (robot.monitor.deceleration, robot.monitor.yaw_deceleration) == (1.5, 12.0)


def test_what_lies_beside_a_urdf_is_bounded(make, tmp_path):
    """Archives that unpack to any size, a pipe, a package.xml with entities, and what regular expressions go over."""
    mesh = tmp_path / "body.zip"
    with zipfile.ZipFile(mesh, "w") as archive:
        archive.writestr("body.obj", trimesh.creation.box((1, 1, 1)).export(file_type="obj"))
    for name in ("pipe", "entities"):
        (tmp_path / name).mkdir()
    os.mkfifo(tmp_path / "pipe" / "package.xml")
    entity = '<!DOCTYPE a [<!ENTITY b "c">]><package><name>&b;</name></package>'
    (tmp_path / "entities" / "package.xml").write_text(entity)
    status, said, _ = make("".join(link(f"l{k}") for k in range(5000)))
    assert (status, "has over 2000 links" in said) == (1, True)
    before = time.process_time()
    comment = "<!--" + "<xacro:include " * 50_000 + "<xacro:arg " * 50_000 + "-->"
    includes = "".join(f'<xacro:include filename="{k}"/>' for k in range(100_000))
    text = (
        comment
        + f"<extra><![CDATA[{includes}]]></extra>"
        + TWO.replace('<box size=".3 .2 .1"/>', '<mesh filename="body.zip"/>')
    )
    status, said, _ = make(text)
    assert (status, "body.zip" in said) == (0, True)
    assert time.process_time() - before < 10.0


def test_a_collada_mesh_has_its_own_unit(tmp_path):
    mesh = trimesh.creation.box((400, 300, 100)).export(file_type="dae").decode()
    (tmp_path / "hull.dae").write_text(mesh.replace("</asset>", '<unit name="mm" meter="0.001"/></asset>'))
    (tmp_path / "a.urdf").write_text('<robot name="a">' + link("base_link", '<mesh filename="hull.dae"/>') + "</robot>")
    (box,) = UrdfFile(str(tmp_path / "a.urdf"), {}).boxes(["base_link"])
    assert (box[1] - box[0]).tolist() == pytest.approx([0.4, 0.3, 0.1])


def test_a_robot_without_laser_is_asked_for_one(make, tmp_path):
    urdf = TWO[: TWO.index('<link name="scanner">')] + '<xacro:arg default="$(optenv LASER_RPY 0)" name="with_laser"/>'
    urdf += '<xacro:arg name="kind" default="more"/><xacro:include filename="$(arg kind).xacro"/>'
    (tmp_path / "more.xacro").write_text(HEAD + '<xacro:if value="$(optenv LIDAR 0)"/></robot>')
    common = COMMON.replace("topic: scan,", "topic: scan, sensor_frame: /mast,")
    status, said, file = make(urdf, **{"costmap_common.yaml": common})
    assert status == 0
    assert re.search(r"no laser: .*; the file takes with_laser:=; it reads LIDAR from the environment\n", said)
    assert yaml.safe_load(file.read_text())["laser"] == {"frame": "mast"}
    assert "laser.range_max [m] range_max of the scans" in said
    assert "  # beams: " in file.read_text()


LYING = TWO.replace("-1.5707963", "0").replace("left", "wheel_left")
PLAIN = TWO + RAYS.replace("$(arg reach)", "1.4")
FAR_MESH = '<mesh filename="package://far/w.stl"/>'
NAMED = "<transmission name='{0}'><joint name='{0}_joint'/></transmission>"
BY_TRANSMISSIONS = PLAIN + wheel("idle_left", "-.15 .05 0") + wheel("idle_right", "-.15 -.05 0")
BY_TRANSMISSIONS += NAMED.format("left") + NAMED.format("right")
RIGHT_AFTER = '<axis xyz="0 0 1"/></joint><link name="right"'
ODD_HEAD = ' \n<!-- a -- b --><?xml version="1.0"?><robot name="crate" xmlns="http://ros">'
MANY_TURNS = '<axis xyz="0 0 1"/><limit lower="-1e16" upper="1e16" effort="1" velocity="1"/>'
SPRUNG = link("arm") + joint("arm", "0 0 0", kind="prismatic", axis="0 0 1") + PLAIN
DRIVE = '<gazebo><plugin name="d" filename="libdiff_drive.so"><leftJoint>left_joint</leftJoint>'
DRIVE += "<rightJoint>right_joint</rightJoint></plugin></gazebo>"
MOVED_SIDEWAYS = '<gazebo><plugin name="m" filename="libplanar_move.so"/></gazebo>'
LIMIT = '<limit lower="-.5" upper=".5" effort="1" velocity="1"/></joint>'
KNUCKLE = link("knuckle") + joint("knuckle", ".2 0 0", kind="revolute", axis="0 0 1").replace("</joint>", LIMIT)
KNUCKLE += wheel("steered", "0 0 0", parent="knuckle")
LOCKED = KNUCKLE.replace("knuckle", "steering").replace('axis xyz="0 0 1"/><limit', 'axis xyz="0 1 0"/><limit')
LOCKED = LOCKED.replace('lower="-.5" upper=".5"', 'lower="0" upper="0"')
TURNED = PLAIN.replace(
    'rpy="0 0 0"/><axis xyz="0 1 0"/></joint><link name="base_link"', 'rpy="0 0 1.57"/></joint><link name="base_link"'
)
LEG = link("leg", '<box size=".02 .02 .1"/>') + joint("leg", "0 .1 0", kind="revolute").replace("</joint>", LIMIT)
IDLE = link("idle", '<sphere radius=".02"/>') + joint("idle", "-.1 0 -.03", kind="continuous")


@pytest.mark.parametrize(
    ("urdf", "more", "line"),
    [
        ("wheels: 2\n", {"head": ""}, "is no XML"),
        ("<sdf/>", {"head": ""}, "outermost tag is <sdf>"),
        (link("a", "<capsule/>"), {}, "cannot be read as URDF: .*; ask check_urdf for the place"),
        (link("a") + "<joint name='hinge' type='Hinge'/>", {}, "joint hinge has the type Hinge: give continuous, rev"),
        (PLAIN.replace('"0 .12 0"', '"0 nan 0"'), {}, "joint left_joint has xyz '0 nan 0': give 3 finite numbers"),
        (PLAIN.replace('radius=".03"', 'radius="3 cm"'), {}, "link roller has radius '3 cm': give 1 finite number"),
        (PLAIN.replace('value="5.0"', 'value="5kg"'), {}, "link base_link has value '5kg': give 1 finite number"),
        (PLAIN.replace('ixx=".01"', 'ixx="nan"'), {}, "link base_link has ixx 'nan': give 1 finite number"),
        (PLAIN + joint("scanner", "0 0 0", "left"), {}, "more than one joint leads to the link scanner: take all but"),
        (PLAIN.replace('left_joint" type="continuous', 'left_joint" type="fixed'), {}, "right, left_joint is fixed "),
        (TWO + wheel("third", "-.1 0 0"), {}, "driven wheels are left, right, third"),
        (TWO + wheel("side", ".1 0 0", turn="0 1.5707963 0"), {}, "side_joint.* omni base"),
        (TWO.replace('"left"', '"mecanum_left"'), {}, "left_joint is of an omni base"),
        (TURNED, {}, "wheels left and right roll along y of base_footprint: give .* such as base_link$"),
        (
            PLAIN + NAMED.format("swivel") + NAMED.format("roller"),
            {},
            r"swivel_joint steers .*\(where others drive it,",
        ),
        (PLAIN + KNUCKLE + NAMED.format("left") + NAMED.format("right"), {}, "knuckle_joint steers the wheel of"),
        (PLAIN + LOCKED, {}, "steering_joint steers the wheel of"),
        (PLAIN + wheel("more", ".1 .12 0") + MOVED_SIDEWAYS, {}, "libplanar_move.so is of an omni base"),
        (PLAIN + joint("nowhere", "0 0 0"), {}, "joints name nowhere, which is no link there; take each"),
        (TWO + RAYS, {}, "needs the argument reach: give reach:=VALUE"),
        (TWO + '<link name="$(env UNSET_PART)"/>', {}, "reads UNSET_PART from the environment: export it"),
        ('<xacro:macro name="m"><link name="a"/></xacro:macro>', {}, "no links, .*: give the file that uses them"),
        ('<xacro:macro name="m"><link name="a"/></xacro:macro><m/>', {}, "them; or is <m> a macro, which since"),
        ('<property name="a" value="1"/><link name="${a}"/>', {}, "it has <property>, and since Noetic xacro takes"),
        (TWO + "<xacro:lms/>", {}, "xacro refuses it: unknown macro name: xacro:lms"),
        (TWO + "<link name='a'>" * 101 + "</link>" * 101, {}, "over 100 levels of tags"),
        (TWO + joint("base_footprint", "0 0 0", "scanner"), {}, "joints above the link scanner lead back"),
        (TWO + "".join(joint(f"l{k}", "0 0 0", f"l{k + 1}") for k in range(102)), {}, "over 100; take one"),
        (TWO + "<link name='loose'/>", {}, "no joint leads to loose, nor to base_footprint: a robot has one root"),
        (TWO, {"dwa.yaml": "<launch/>"}, "dwa.yaml is no YAML; of a launch file give .*: roslaunch --dump-params"),
        (TWO, {"dwa.yaml": "local_costmap:\n  ros__parameters: {width: 3}\n"}, "dwa.yaml is for ROS 2: give"),
        (TWO, {"dwa.yaml": "max_vel_x: $(arg fast)\n"}, "dwa.yaml: .*add fast:=VALUE"),
        (TWO, {"dwa.yaml": "max_vel_x: $(eval 1+1)\n"}, r"dwa.yaml: \$\(eval 1\+1\) is for roslaunch alone"),
        (TWO, {"dwa.yaml": "max_vel_x: $(env UNSET_SPEED)\n"}, "dwa.yaml: not set .*: UNSET_SPEED; export each"),
        (TWO, {"dwa.yaml": "map: $(find no_such)/a\n"}, "dwa.yaml: packages that are not there: no_such; source"),
    ],
)
def test_what_is_wrong_is_one_line(make, urdf, more, line):
    status, said, file = make(urdf, **more)
    assert status == 1
    assert re.fullmatch(rf"\./applr robot: .*{line}.*\n", said), said
    assert not file.exists()


def test_old_tags_of_an_included_file_are_named(make, tmp_path):
    (tmp_path / "body.xacro").write_text('<robot><property name="a" value="1"/></robot>')
    included = '<xacro:include filename="body.xacro"/><link name="${a}"/>'
    assert re.search(r"; \S+/body.xacro has <property>, and since Noetic xacro takes", make(included)[1])


BARE_LEFT = link("wheel_left") + joint("wheel_left", "0 .12 0", kind="continuous")
BARE = TWO[: TWO.index('<link name="left">')] + BARE_LEFT + BARE_LEFT.replace("left", "right").replace(".12", "-.12")
LEGGED = link("base_link") + link("base_footprint") + joint("base_footprint", "0 0 0") + LEG + NAMED.format("leg")
FIXED_DISC = link("camera", '<box size=".02 .01 .02"/>') + joint("camera", ".11 0 0")
WHEEL_SHAPE = '<cylinder radius=".05" length=".02"/>'


@pytest.mark.parametrize(
    ("urdf", "remark", "known"),
    [
        (link("base_footprint", '<box size="1 1 1"/>'), "another URDF, give that", {}),
        (LEGGED, "another URDF, give that", {}),
        (LYING.replace("continuous", "fixed"), "wheel_left_joint is fixed: make the", {}),
        (PLAIN.replace(WHEEL_SHAPE, FAR_MESH), "put the package of package://far/w.stl", {}),
        (BARE, "another URDF", {"drive": "two_wheel", "track": 0.24, "axle_height": 0.05}),
        (BARE + FIXED_DISC, "another URDF", {"drive": "two_wheel", "track": 0.24, "axle_height": 0.05}),
        (
            BARE + BARE_LEFT.replace("left", "back").replace("0 .12", "-.2 0"),
            "another URDF",
            {},
        ),
        (
            (BARE + BARE_LEFT.replace("left", "back_left").replace("0 .12", "-.2 .12"))
            + BARE_LEFT.replace("left", "back_right").replace("0 .12", "-.2 -.12"),
            "another URDF",
            {"drive": "skid_steer", "track": 0.24, "axle_height": 0.05, "wheelbase": 0.2},
        ),
    ],
    ids=[
        "a box",
        "a leg",
        "fixed",
        "meshes elsewhere",
        "two joints",
        "two joints and a fixed disc",
        "three joints",
        "four joints",
    ],
)
def test_wheels_that_are_not_drawn_are_asked_for(make, urdf, remark, known):
    status, said, file = make(urdf)
    assert status == 0, said
    assert re.search(f"remark: no wheels are drawn: .*{remark}", said), said
    found = yaml.safe_load(file.read_text())
    stated = {name: value for name, value in (found["base"] or {}).items() if name in known}
    assert stated == known
    asked = {"drive", "wheel_radius", "wheel_width", "track", "axle_height"} - set(known)
    assert set(re.findall(r"^  base\.(\w+) ", said, re.MULTILINE)) >= asked
    assert ("\n  base.casters" in said) == (known.get("drive") != "skid_steer")


CODE = "[w.__init__.__globals__['system']('touch {0}') for s in [python.type.mro(python.list)[1]] "
CODE += "for w in s.__subclasses__() if w.__name__ == '_wrap_close']"
TO_THEMSELVES = "it is nested too deep or too large"


@pytest.mark.parametrize(
    ("urdf", "line"),
    [
        ('<link name="${{' + CODE + '}}"/>', "more than arithmetic"),
        ('<link name="$(eval [many for many in [1]])"/>', "more than arithmetic"),
        ('<xacro:property name="len" value="${{python.vars}}"/><link name="${{len(math).x}}"/>', "len.*more than"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', TO_THEMSELVES),
        ("<link name=\"${{'a' * 10**10}}\"/>", TO_THEMSELVES),
        ('<link name="${{9**9**9}}"/>', "takes over 2 s"),
    ],
)
def test_a_xacro_file_runs_no_code_and_is_bounded(make, tmp_path, monkeypatch, urdf, line):
    monkeypatch.setitem(LIMITS, "CPU", 2)
    status, said, _ = make(urdf.format(tmp_path / "ran") + TWO)
    assert status == 1
    assert re.fullmatch(rf"\./applr robot: .*{line}.*; if you trust .*: xacro \S+crate.urdf > robot.urdf\n", said), said
    assert not (tmp_path / "ran").exists()


def test_a_xacro_file_calculates(tmp_path):
    (tmp_path / "sizes.yaml").write_text("wheel: {radius: .1, sides: [left, right]}\n")
    wanted = {
        "radians(180) == pi and 2 * -(3 // 2) + 7 % 4": 1,
        "max(len(name), 2) if 1 < 2 <= 2 and not 0 else 5": 5,
        "sizes['wheel']['radius'] ** 2": 0.1**2,
        "'%s_%d' % (sizes.wheel.sides[1:][0].upper(), round(math.sqrt(16)))": "RIGHT_4",
        "name in ('crate', 'box')": True,
    }
    text = '<xacro:arg name="many" default="3"/><xacro:property name="name" value="crate"/>'
    text += '<xacro:property name="sizes" value="${xacro.load_yaml(\'sizes.yaml\')}"/>'
    text += "".join(f'<link name="${{{escape(expression)}}}"/>' for expression in wanted)
    text += '<link name="$(eval many * 2)"/>'
    (tmp_path / "a.xacro").write_text(HEAD + text + "</robot>")
    urdf, problem, _ = expand(str(tmp_path / "a.xacro"), {}, {})
    assert re.findall('<link name="(.*?)"', urdf) == [str(value) for value in (*wanted.values(), 6)], problem


BELOW_ARM = ('<parent link="base_link"/><child link="left"/>', '<parent link="arm"/><child link="left"/>')
DRIVEN = {
    "transmissions": BY_TRANSMISSIONS,
    "plugin": BY_TRANSMISSIONS.replace("transmission", "other") + DRIVE,
    "controller": BY_TRANSMISSIONS.replace("transmission", "other"),
    "omni": PLAIN.replace('"roller"', '"omni_wheel"'),
    "many turns": PLAIN.replace(RIGHT_AFTER, MANY_TURNS + '</joint><link name="right"'),
    "sprung": SPRUNG.replace(*BELOW_ARM),
    "harmless parts": PLAIN
    + "<material/><gazebo reference='nothing'><sensor/></gazebo>"
    + link("emblem", "<mesh/>")
    + joint("emblem", "0 0 .1"),
    "all fixed": PLAIN.replace("continuous", "fixed"),
    "revolute without limits": PLAIN.replace("continuous", "revolute"),
    "axes along the robot": PLAIN.replace('axis xyz="0 0 1"', 'axis xyz="1 0 0"'),
    "axes that say nothing": PLAIN.replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"'),
    "small ones that idle": PLAIN + IDLE + link("mark", '<box size=".002 .002 .002"/>') + joint("mark", "0 0 -.05"),
    "plugin before transmissions": PLAIN + DRIVE + NAMED.format("swivel") + NAMED.format("roller"),
    "one joint of each controller": PLAIN + NAMED.format("swivel") + NAMED.format("roller"),
    "mimic": PLAIN.replace(RIGHT_AFTER, f"<mimic joint='right_joint'/>{RIGHT_AFTER}")
    + wheel("idle", "-.15 .05 0")
    + NAMED.format("right")
    + IDLE.replace("idle", "other"),
    "hubs": PLAIN.replace("continuous", "fixed")
    + link("hub", '<cylinder radius=".05" length=".01"/>')
    + joint("hub", "0 0 0", "left"),
    "moved sideways in Gazebo": PLAIN + MOVED_SIDEWAYS,
    "blank and comment": "\n" + PLAIN + "<not:declared>this & that</not:declared>",
}


@pytest.mark.parametrize("kind", DRIVEN)
def test_driven_wheels(make, kind):
    more = {
        "controller": {"control.yaml": DIFF_DRIVE},
        "one joint of each controller": {"control.yaml": ONE_EACH},
        "blank and comment": {"head": ODD_HEAD, "tail": "</robot>"},
    }
    status, said, file = make(DRIVEN[kind], **more.get(kind, {}))
    assert status == 0, said
    base = yaml.safe_load(file.read_text())["base"]
    assert (base["drive"], base["track"], base["wheel_radius"]) == ("two_wheel", 0.24, 0.05)
    assert [-0.15, 0.0] in base["casters"]


def test_fixed_wheels_are_named(make):
    assert (
        "remark: taken for driven wheels, though they are fixed: left_joint, right_joint\n"
        in make(PLAIN.replace("continuous", "fixed"))[1]
    )


def test_what_cannot_be_is_remarked_and_a_base_frame_of_tf_is_taken(make):
    heavy = PLAIN.replace('value="0.4"', 'value="100"')
    _, said, file = make(heavy, **{"costmap_common.yaml": COMMON.replace("base_footprint", "hull")})
    assert re.search(r"remark: a wheel weighs 100 kg in .*, and 1.23 kg if it were all of steel: look at", said)
    assert re.search("remark: .* has no link hull, .*: places are in base_link", said)
    assert yaml.safe_load(file.read_text())["frames"]["base"] == "hull"


def test_a_laser_below_the_base_frame_has_its_place_in_the_root(make):
    low = PLAIN.replace('".05 0 .15"', '".05 0 -.02"')
    _, said, file = make(low, **{"costmap_common.yaml": COMMON.replace("base_footprint", "base_link")})
    found = yaml.safe_load(file.read_text())
    assert (found["frames"]["base"], found["laser"]["height"]) == ("base_footprint", 0.03)
    assert "remark: the laser lies below base_link: places are in base_footprint\n" in said
    assert found["move_base"]["parameters"]["local_costmap"]["robot_base_frame"] == "base_footprint"


def test_parameters_as_roslaunch_and_rosparam_read_them(make, monkeypatch, tmp_path):
    (tmp_path / "package.xml").write_text("<package><name>crate-nav</name></package>")
    monkeypatch.setenv("TURN", "0.7")
    angles = PLANNER.replace("max_vel_theta: 1.5", "max_vel_theta: rad(pi/2)").replace("0.1}", "!degrees 9.0, %s}")
    nested = "robot: {move_base: {NavfnROS: {allow_unknown: $(arg unknown)}}}\nmove_base/planner_frequency: 2.0\n"
    nested += "---\n_ns: move_base/NavfnROS\ndefault_tolerance: 0.3\n"
    local = LOCAL.replace("odom_comb", "$(arg prefix)odom").replace("width: 5", "width: 5, map_type: voxel")
    angles = angles.replace("x: 0.4", "x: $(optenv SLOW 0.3)").replace(
        "acc_lim_theta: 3.0", "acc_lim_theta: $(env TURN)"
    )
    angles %= 'global_frame_id: "$(find crate-nav)/a"'
    files = {"dwa.yaml": "%YAML 1.1\n---\n" + angles, "navfn.yaml": nested.partition("\n")[0]}
    files.update(
        {
            "costmap_local.yaml": local,
            "rate.yaml": nested.partition("\n")[2],
            "costmap_global.yaml": "{global_frame: site_map}\n",
        }
    )
    _, said, file = make(PLAIN, "prefix:=my_", "unknown:=false", **files)
    fill(file)
    robots.folder._read.cache_clear()
    robot = robots.load(str(file.parent), list)
    tree = robot.parameters(with_map=True)
    assert tree["DWAPlannerROS"]["max_vel_theta"] == pytest.approx(1.5707963)
    assert tree["DWAPlannerROS"]["min_vel_theta"] == pytest.approx(0.1570796)
    assert [tree["DWAPlannerROS"][name] for name in ("max_vel_x", "acc_lim_theta")] == [0.3, 0.7]
    assert tree["DWAPlannerROS"]["global_frame_id"] == f"{tmp_path}/a"
    assert (tree["NavfnROS"], tree["planner_frequency"]) == ({"allow_unknown": False, "default_tolerance": 0.3}, 2.0)
    assert tree["local_costmap"]["global_frame"] == "my_odom"
    assert robot.frames.map == "site_map"


@pytest.mark.parametrize("frame", ["odom", "map"])
def test_both_costmaps_may_be_in_one_frame_of_any_name(make, capsys, frame):
    common = COMMON.replace("base_footprint", "base-link") + "global_frame: two/odom-combined\n"
    common = common if frame == "map" else re.sub("  - {name: map.*\n", "", common) + "rolling_window: true\n"
    local = LOCAL.replace("global_frame: odom_comb, ", "")
    _, said, file = make(
        PLAIN.replace("base_footprint", "base-link"), **{"costmap_common.yaml": common, "costmap_local.yaml": local}
    )
    assert yaml.safe_load(file.read_text())["frames"][frame] == "two/odom-combined"
    fill(file)
    robots.folder._read.cache_clear()
    assert check_robot.main([str(file.parent)]) == 0, capsys.readouterr()


@pytest.mark.parametrize("rolls", [True, False])
def test_a_rolling_global_costmap_that_stands_on_courses_is_said_to(make, rolls):
    world = f"{{global_frame: map, rolling_window: {str(rolls).lower()}, width: 10, height: 10}}\n"
    status, said, file = make(PLAIN, **{"costmap_global.yaml": world})
    assert status == 0, said
    costmap = yaml.safe_load(file.read_text())["move_base"]["without_map"]["parameters"]["global_costmap"]
    assert costmap["rolling_window"] is False
    line = "remark: without a map, as on courses, the global costmap does not move along with the robot"
    assert (f"{line}: it is {costmap['width']} m wide" in said) == rolls, said


def test_one_file_may_hold_all_parameters_of_a_robot(make):
    tree = {"robot_description": "<robot/>" * 30_000, "move_base": yaml.safe_load(PLANNER)}
    status, said, file = make(PLAIN, **{"dwa.yaml": yaml.safe_dump({**tree, **yaml.safe_load(CONTROLLER)})})
    assert status == 0, said
    assert yaml.safe_load(file.read_text())["base"]["max_speed"] == 0.6


def test_a_wrong_value_leaves_the_scale_of_worlds_right(make):
    wrong = {
        "dwa.yaml": PLANNER.replace("max_vel_x: 0.4", "max_vel_x: .nan"),
        "costmap_common.yaml": COMMON + "resolution: 0\n",
    }
    _, said, file = make(PLAIN, **wrong)
    (line,) = re.findall("remark: the planner refuses the parameter files: (.*)", said)
    assert re.search("DWAPlannerROS/max_vel_x is nan: give a finite number", line)
    assert re.search("_costmap/resolution, .*_costmap/resolution are 0, which cannot work", line)
    assert yaml.safe_load(file.read_text())["world_scale"] == pytest.approx(0.28 / 0.53, abs=1e-3)


def test_a_local_planner_that_is_not_here_gives_its_limits_to_one_that_is(make, capsys):
    teb = "Other: {max_vel_x: 0.35, max_vel_theta: 0.9, acc_lim_x: 0.5, acc_lim_theta: 0.6, dt_ref: 0.3}\n"
    for planner in ("teb_local_planner/Other", "nav_core_adapter::LocalPlannerAdapter", "Other"):
        named = f"base_local_planner: {planner}\n" * (planner != "Other")  # else by the launch file alone
        _, said, file = make(PLAIN, **{"dwa.yaml": named + teb})
        assert f"remark: DWAPlannerROS drives here, not {planner}: with its speeds" in said
        fill(file)
        robots.folder._read.cache_clear()
        assert check_robot.main([str(file.parent)]) == 0, capsys.readouterr()
        robot = robots.load(str(file.parent))
        own = robot.parameters()["DWAPlannerROS"]
        names = ("max_vel_x", "max_vel_trans", "max_vel_theta", "acc_lim_x", "acc_lim_theta", "path_distance_bias")
        assert [own[name] for name in names] == [0.35, 0.35, 0.9, 0.5, 0.9, 32.0]
        assert len(default_space(robot.base, robot.body, {"base_local_planner": planner})) > 5
        file.unlink()


SLASH = "local_costmap/seen/scan/topic: /scan\n"


@pytest.mark.parametrize(
    "changes",
    [
        {"bumper": "scan_b", "topic: bumps": "topic: rear, sensor_frame: back"},
        {"  observation_sources": "  z_voxels: 8\n  mark_threshold: 0\n  observation_sources"},
        {"margin: {": "other_layer: {some: 1}\nmargin: {"},
        {"margin: {inflation_radius: 0.3}": "inflation_radius: 1.5"},
        {"bumper scan": "bumper front", " scan: {data_type: LaserScan, topic: scan,": " front: {data_type: LaserScan,"},
    ],
    ids=["two sensors", "a voxel layer's own", "a layer not in use", "a value above its layer", "a source's name"],
)
def test_what_is_left_out_is_no_error_afterwards(make, capsys, changes):
    common = COMMON
    for old, new in changes.items():
        common = common.replace(old, new)
    _, said, file = make(
        PLAIN, **{"costmap_common.yaml": common, "more.yaml": "TebLocalPlannerROS: {dt_ref: 0.3}\n" + NAVFN + SLASH}
    )
    fill(file)
    robots.folder._read.cache_clear()
    assert check_robot.main([str(file.parent)]) == 0, capsys.readouterr()
    said = capsys.readouterr().out
    assert "bumper" not in said
    assert "warning" not in said
    assert re.search("TebLocalPlannerROS (is|are) not read here", said)


def test_layers_and_planners_as_move_base_has_them(make, tmp_path):
    common = COMMON.replace("bumper scan", "scan") + "\nseen_too: {observation_sources: cloud, cloud: {topic: cloud}}\n"
    common = common.replace("robot_base_frame: base_footprint", "robot_base_frame: two/base_footprint")
    eband = "EBandPlannerROS: {max_vel_lin: 0.35, max_vel_th: 0.7, max_acceleration: 0.3, xy_goal_tolerance: 0.12}\n"
    (tmp_path / "manifest.xml").write_text("<package/>")
    (tmp_path / "hull.stl").write_bytes(trimesh.creation.box((0.4, 0.2, 0.1)).export(file_type="stl"))
    hull = f'<mesh filename="package://{tmp_path.name}/hull.stl"/>'
    urdf = PLAIN.replace('<box size=".3 .2 .1"/>', hull)
    control = "diff: {type: diff_drive_controller/DiffDriveController, linear: "
    control += "{x: {has_velocity_limits: true, max_velocity: 1}}}"
    files = {"costmap_common.yaml": common, "dwa.yaml": eband, "control.yaml": control}
    status, said, file = make(urdf, **files)
    assert status == 0, said
    found = yaml.safe_load(file.read_text())
    assert (found["body"]["size"][0], found["base"]["command_timeout"]) == (0.4, 0.5)
    assert (found["frames"]["base"], found["laser"]["frame"]) == ("two/base_footprint", "two/scanner")
    stand_in = found["move_base"]["parameters"]["DWAPlannerROS"]
    names = ("max_vel_x", "max_vel_theta", "acc_lim_x", "xy_goal_tolerance")
    assert [stand_in[name] for name in names] == [0.35, 0.7, 0.35, 0.12]
    assert "DWAPlannerROS drives here, not EBandPlannerROS" in said
    assert "take nothing from" not in said
    assert "has no link" not in said
    slow = {"control.yaml": control.replace("linear", "cmd_vel_timeout: 1000, linear")}
    assert yaml.safe_load(make(PLAIN, out="slow", **slow)[2].read_text())["base"]["command_timeout"] == 0.0


def test_a_stand_in_has_an_inflation_layer_and_names_have_levels(make):
    bare = COMMON.replace('  - {name: margin, type: "costmap_2d::InflationLayer"}\n', "").replace(
        "topic: scan,", "topic: /a/scan/,"
    )
    teb = (
        "/two/move_base/:\n  TebLocalPlannerROS: {max_vel_x: 0.4, max_vel_theta: 1.0, acc_lim_x: 1, acc_lim_theta: 1}\n"
    )
    teb += "  local_costmap/: {seen/scan/raytrace_range: 2.0}\n"
    status, said, file = make(PLAIN, **{"costmap_common.yaml": bare, "dwa.yaml": teb})
    assert status == 0, said
    found = yaml.safe_load(file.read_text())
    assert found["topics"]["scan"] == "/a/scan"
    plugins = found["move_base"]["parameters"]["local_costmap"]["plugins"]
    assert [layer["name"] for layer in plugins] == ["map", "seen", "inflation_layer"]
    fill(file)
    local = robots.load(str(file.parent), list).parameters()["local_costmap"]
    assert (local["seen"]["scan"]["raytrace_range"], local["plugins"][-1]["name"]) == (2.0, "inflation_layer")


def test_a_robot_that_is_there_is_not_overwritten(make):
    assert make(TWO)[0] == 0
    status, said, _ = make(TWO)
    assert (status, said.count("\n")) == (1, 1)
    assert "robot.yaml is there already" in said


def test_a_full_disk_leaves_no_robot_in_the_way_of_the_next_try(make, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        status, said, file = make(TWO)
    assert (status, said.count("\n"), file.exists()) == (1, 1, False), said
    assert make(TWO)[0] == 0


def test_a_link_in_a_circle_and_a_folder_are_one_line(tmp_path, make, capsys):
    make(TWO)
    (tmp_path / "circle").symlink_to("circle")
    words = ["--out", str(tmp_path / "out"), "--parameters"]
    for urdf, file in (("circle", "dwa.yaml"), ("/", "dwa.yaml"), ("crate.urdf", "circle")):
        assert new_robot.main([str(tmp_path / urdf), *words, str(tmp_path / file)]) == 1
        assert capsys.readouterr().err.count("\n") == 1


CROSSING = '<collision><origin xyz="-.05 0 .06"/><geometry><box size=".2 .3 .1"/></geometry></collision>'


def test_a_round_body_is_no_box(make):
    _, said, file = make(PLAIN.replace('<box size=".3 .2 .1"/>', '<cylinder radius=".15" length=".1"/>'))
    assert yaml.safe_load(file.read_text())["body"]["round"] is True
    fill(file)
    robot = robots.load(str(file.parent))
    ends, parts = robots.geometry.corners(robot) - robot.body.centre, np.array(robots.geometry.parts(robot))
    assert parts[:4, 2:].max(axis=0).tolist() == pytest.approx([0.15, 0.15])
    assert np.hypot(*ends[:16].T).max() == pytest.approx(0.15, rel=0.02)
    assert (ends[:, 0].max(), len(MonitorSettings.of(robot).body)) == (pytest.approx(0.15), 24)
    assert 'cylinder radius="0.15"' in urdf_of(robot)
    cross = PLAIN.replace("</inertial><collision>", "</inertial>" + CROSSING + "<collision>", 1)
    assert "round" not in yaml.safe_load(make(cross, out="crossed")[2].read_text())["body"]


def test_a_body_is_what_reaches_over_the_axle_and_ends_at_the_ground(make):
    low = PLAIN.replace('at="-.05 0 .06"', "").replace('<box size=".3 .2 .1"/>', '<box size=".3 .2 .104"/>')
    low = low.replace('xyz="-.05 0 .06"', 'xyz="-.05 0 0"')
    body = yaml.safe_load(make(low)[2].read_text())["body"]
    assert (body["bottom"], body["size"][2]) == (0.0, 0.22)
    lost = PLAIN.replace('<box size=".3 .2 .1"/>', FAR_MESH)
    status, said, file = make(lost, out="lost")
    assert status == 0
    assert "size" not in yaml.safe_load(file.read_text())["body"]
    assert "body.size [m] [length, width, height]" in said


def visual(name, shape, at="0 0 0"):
    return f'<link name="{name}"><visual><origin xyz="{at}"/><geometry>{shape}</geometry></visual></link>'


NO_CASTER = PLAIN.replace(link("roller", '<sphere radius=".03"/>', 0.2), link("roller"))
MARKED = {
    "a plate": '<box size=".05 .05 .001"/>',
    "a disc": '<cylinder radius=".3" length=".002"/>',
    "a ball": '<sphere radius=".01"/>',
    "axes": '<box size=".1 .1 .1"/>',
}


@pytest.mark.parametrize("kind", MARKED)
def test_the_mark_of_a_frame_is_no_caster_and_no_body(make, kind):
    mark = visual("base_footprint", MARKED[kind], ".02 0 0" if kind == "axes" else "0 0 0")
    drawn = NO_CASTER.replace('<link name="base_footprint"/>', mark)
    _, said, file = make(drawn)
    assert "base.casters" in said
    assert "casters" not in yaml.safe_load(file.read_text())["base"]
    seen = drawn.replace("collision>", "visual>")  # the body is what is seen, and not its mark
    body = yaml.safe_load(make(seen, out="seen")[2].read_text())["body"]
    assert body["size"] == [0.3, 0.2, 0.16] or kind == "axes"


def test_a_caster_that_is_drawn_alone_is_one_and_none_lies_below_the_axle(make):
    small = visual("ball", '<sphere radius=".02"/>') + joint("ball", ".14 0 -.03")
    below = link("skid", '<sphere radius=".02"/>') + joint("skid", "0 .05 -.03")
    _, _, file = make(NO_CASTER + small + below)
    assert yaml.safe_load(file.read_text())["base"]["casters"] == [[0.14, 0.0]]


def test_a_body_keeps_its_outline_where_a_shape_of_its_own_is_the_caster(make):
    ball = '<collision><origin xyz="-.15 0 -.02"/><geometry><sphere radius=".03"/></geometry></collision>'
    base = link("base_link", '<box size=".3 .2 .1"/>', 5.0, at="-.05 0 .06")
    status, said, file = make(NO_CASTER.replace(base, base.replace("</link>", ball + "</link>")))
    assert status == 0, said
    found, plain = yaml.safe_load(file.read_text()), yaml.safe_load(make(PLAIN, out="plain")[2].read_text())
    assert found["base"]["casters"] == [[-0.15, 0.0]]
    assert found["body"]["size"] == plain["body"]["size"]
    assert found["body"]["bottom"] == plain["body"]["bottom"]


def test_casters_below_the_axle_alone_are_refused(make, capsys):
    _, _, file = make(PLAIN)
    text = file.read_text()
    for place, status in (("[[0.0, 0.1], [0.005, -0.1]]", 1), ("[[-0.15, 0.0]]", 0)):
        file.write_text(text.replace("[[-0.15, 0.0]]", place).replace("com: [-0.04, 0.0", "com: [0.0, 0.0"))
        fill(file)
        robots.folder._read.cache_clear()
        assert check_robot.main([str(file.parent)]) == status
        said = capsys.readouterr().err
        assert ("base.casters is [0, 0.1], [0.005, -0.1]: " in said) == status, said


def test_an_inertia_of_another_size_is_a_warning(make, capsys):
    _, _, file = make(PLAIN)
    text = re.sub("(?<=body:)(.*?inertia: )[^\n]*", r"\1[MOMENT, 0.04, 0.05]", file.read_text(), flags=re.DOTALL)
    for moment, said_so in (("0.1", False), ("0.0002", True), ("0.2", True)):  # of a full box .0328
        file.write_text(text.replace("MOMENT", moment))
        fill(file)
        robots.folder._read.cache_clear()
        assert check_robot.main([str(file.parent)]) == 0
        said = capsys.readouterr().out
        assert (f"warning: {file}: body.inertia is [{moment}, 0.04, 0.05]: a full box" in said) == said_so, said


def test_the_mass_of_some_parts_is_not_that_of_the_whole(make):
    hull = link("base_link", '<box size=".3 .2 .1"/>', 5.0, at="-.05 0 .06")
    unweighed = PLAIN.replace(hull, link("base_link", '<box size=".3 .2 .1"/>', at="-.05 0 .06"))
    _, said, file = make(unweighed)
    assert "remark: base_link, the largest part of the body, has no mass: roller (0.2 kg), scanner (0.8 kg)" in said
    assert "body.mass [kg]" in said
    assert not {"mass", "com", "inertia"} & set(yaml.safe_load(file.read_text())["body"])
    of_all = unweighed + link("inertial_link", mass=6.0) + joint("inertial_link", "0 0 .05")
    assert yaml.safe_load(make(of_all, out="whole")[2].read_text())["body"]["mass"] == 7.0
    for out, name, mass in (("camera", "camera_mast", 6.0), ("token", "inertial_link", 0.01)):
        urdf = unweighed + link(name, mass=mass) + joint(name, "0 0 .05")
        assert "mass" not in yaml.safe_load(make(urdf, out=out)[2].read_text())["body"]
    token = PLAIN.replace('value="5.0"', 'value="0.001"')  # a hull lighter than foam
    assert "mass" not in yaml.safe_load(make(token, out="light")[2].read_text())["body"]


RIGHT = joint("right", "0 -.12 0", kind="continuous", axis="0 0 1", turn="-1.5707963 0 0")


def test_a_wheel_weighs_what_those_do_whose_mass_is_given(make):
    one = PLAIN.replace(wheel("right", "0 -.12 0"), link("right", WHEEL_SHAPE) + RIGHT)
    base = yaml.safe_load(make(one)[2].read_text())["base"]
    assert (base["wheel_mass"], base["wheel_inertia"]) == (0.4, [0.01, 0.01, 0.01])


EACH = PLAIN + "".join(map(NAMED.format, ("left", "right", "swivel", "roller")))


def test_a_transmission_on_a_caster_does_not_drive(make):
    _, said, file = make(EACH)
    base = yaml.safe_load(file.read_text())["base"]
    assert (base["drive"], base["track"], base["casters"]) == ("two_wheel", 0.24, [[-0.15, 0.0]]), said
    large = EACH.replace('<sphere radius=".03"/>', '<sphere radius=".05"/>').replace('"-.15 0 -.02"', '"-.15 0 0"')
    status, said, _ = make(large, out="large")  # as large as the others: a wheel that is steered
    assert (status, "swivel_joint steers the wheel of roller_joint" in said) == (1, True)


EXPLORE = (
    "explore: {robot_base_frame: base_link, planner_frequency: 0.33, transform_tolerance: 2.0, gain: 1, size: 0.7}\n"
)
OTHERS = {
    "explore.yaml": EXPLORE.partition(": ")[2],
    "explore_node.yaml": EXPLORE,
    "goal_controller.yaml": "{global_frame: map, kv: 2.5, kp: 3.0, vmax: 0.3}\n",
    "follower.yaml": "{max_vel_x: 9.0, gain: 1.0, ahead: 0.3}\n",
    "teleop.yaml": "teleop: {max_vel_x: 9.0, button: 3}\n",
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_name_that_other_nodes_share_does_not_make_a_file_move_bases(make, name):
    local = {"costmap_local.yaml": LOCAL, "dwa.yaml": PLANNER}  # OTHERS come last, where they would count
    status, said, file = make(PLAIN, **local, **{name: OTHERS[name]})
    assert status == 0, said
    assert re.search(f"remark: .*{name} is left out: it has no parameters of move_base", said), said
    files = {one["file"] for one in yaml.safe_load(file.read_text())["move_base"]["files"]}
    assert files == {"costmap_common.yaml", "costmap_local.yaml", "dwa.yaml"}


def test_a_file_with_some_names_of_other_versions_is_move_bases(make):
    more = {
        "move_base.yaml": "{controller_frequency: 7.0, oscillation_timeout: 5.0, max_planning_time: 1.0}\n",
        "teb_flat.yaml": "{max_vel_x: 0.4, max_vel_theta: 1.0, acc_lim_x: 1, acc_lim_theta: 1, dt: 1, a: 1, b: 1}\n",
        "costmap_global.yaml": "{update_frequency: 1.5, map_source: 1}\n",
    }
    _, said, file = make(PLAIN, **more)
    files = yaml.safe_load(file.read_text())["move_base"]["files"]
    places = {one["file"]: one.get("namespace", "") for one in files}
    assert [places[name] for name in more] == ["", "TrajectoryPlannerROS", "global_costmap"], said


SOURCES = "observation_sources: scan\nscan: {data_type: LaserScan, topic: scan, marking: true, clearing: true}\n"


def test_a_layers_own_file_is_loaded_below_the_layer(make):
    common = COMMON.partition("seen:\n")[0] + "margin: {inflation_radius: 0.3}\n"
    _, said, file = make(PLAIN, **{"costmap_common.yaml": common, "obstacles.yaml": SOURCES})
    found = yaml.safe_load(file.read_text())["move_base"]["files"]
    places = [one["namespace"] for one in found if one["file"] == "obstacles.yaml"]
    assert places == ["local_costmap/seen", "global_costmap/seen"]
    assert "obstacles.yaml is loaded below local_costmap/seen, the layer that has no sources" in said
    fill(file)
    robots.folder._read.cache_clear()
    assert check_robot.main([str(file.parent)]) == 0
    two = common.replace("  - {name: margin", '  - {name: near, type: "costmap_2d::ObstacleLayer"}\n  - {name: margin')
    _, said, file = make(PLAIN, out="two", **{"costmap_common.yaml": two, "obstacles.yaml": SOURCES})
    assert "obstacles.yaml holds a layer's own values: write them below its name in local_costmap (seen, near)" in said
    _, said, file = make(PLAIN, out="named", **{"costmap_common.yaml": two, "layer_near.yaml": SOURCES})
    places = [one.get("namespace") for one in yaml.safe_load(file.read_text())["move_base"]["files"]]
    assert places[-2:] == ["local_costmap/near", "global_costmap/near"]
    _, said, _ = make(PLAIN, out="above", **{"costmap_common.yaml": two + SOURCES})  # C++ reads them there for no layer
    assert "write them and what they name below local_costmap/seen" in said


def test_the_first_of_several_is_taken_with_a_word(make):
    common = COMMON.replace("bumper scan", "rear scan").replace(
        "  bumper: {data_type: PointCloud2, topic: bumps,", "  rear: {data_type: LaserScan, topic: scan_rear,"
    )
    twice = RAYS.replace("$(arg reach)", "1.4").replace('name="rays"', 'name="more"').replace("<max>8<", "<max>4<")
    control = CONTROLLER + CONTROLLER.replace("crate_", "arm_").replace("0.6", "0.9")
    both = "a: {move_base: {planner_frequency: 2.0}}\nb: {move_base: {planner_frequency: 3.0}}\n"
    several = "".join(
        f"{name}: {{max_vel_x: 0.{n}, max_vel_theta: 1, acc_lim_x: 1, acc_lim_theta: 1}}\n"
        for name, n in (("AROS", 3), ("BROS", 4))
    )
    files = {"costmap_common.yaml": common, "control.yaml": control, "two.yaml": both, "dwa.yaml": several}
    _, said, file = make(PLAIN + twice, **files)
    found = yaml.safe_load(file.read_text())
    assert re.search("laser scans of the costmaps scan_rear is topics.scan.* topics.more_scans: .scan.", said), said
    assert found["topics"]["scan"] == "scan_rear"
    assert "controllers state several values of max_speed: 0.9 counts, not 0.6" in said
    assert (found["base"]["max_speed"], said.count("several values")) == (0.9, 1)
    assert "two.yaml: of a/move_base, b/move_base the first is taken" in said
    assert "DWAPlannerROS drives here, not AROS: with the speeds of AROS, not of BROS" in said
    assert "of the sensors rays, more of scanner the first is taken" in said
    assert found["laser"]["range_max"] == 8.0


def test_a_limit_that_is_not_finite_is_none(make):
    control = CONTROLLER.replace("0.6", ".inf")
    _, said, file = make(PLAIN.replace("<max>8<", "<max>inf<"), **{"control.yaml": control})
    found = yaml.safe_load(file.read_text())
    assert "max_speed" not in found["base"]
    assert "range_max" not in found["laser"]
    assert "base.max_speed" in said
