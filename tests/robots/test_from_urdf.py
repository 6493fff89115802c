"""A robot's folder, written from its URDF or xacro file and its parameter files."""

import re
from xml.sax.saxutils import escape

import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.robots import xacro_file
from applr_ros1.robots.default_space import default_space
from applr_ros1.robots.urdf_file import UrdfFile
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
<scan><horizontal><samples>361</samples><min_angle>-1.5</min_angle><max_angle>$(arg reach)</max_angle></horizontal>
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


DIFF_DRIVE = "crate_controller: {left_wheel: [left_joint], right_wheel: right_joint}\n"


@pytest.fixture
def make(tmp_path, capsys):
    """Writes the files and the robot's folder: (exit status, what was printed, robot.yaml)."""

    def run(urdf, *words, head=HEAD, tail="", **parameters):
        files = {"costmap_common.yaml": COMMON, "costmap_local.yaml": LOCAL, "dwa.yaml": PLANNER, **parameters}
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        (tmp_path / "crate.urdf").write_text(head + urdf + (tail or "</robot>" * (head == HEAD)))
        out = tmp_path / "my_robot"
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
    laser = {"frame": "scanner", "pose": [0.05, 0.0, 0.0], "height": 0.2, "beams": 361, "first_angle": -1.5}
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
    robots.reader._read.cache_clear()
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
    robots.reader._read.cache_clear()
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
    status, said, file = make(
        urdf + rays,
        **{"costmap_common.yaml": COMMON.replace("base_footprint", "base_link"), "control.yaml": CONTROLLER},
    )
    assert status == 0, said
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


def test_a_collada_mesh_has_its_own_unit(tmp_path):
    mesh = trimesh.creation.box((400, 300, 100)).export(file_type="dae").decode()
    (tmp_path / "hull.dae").write_text(mesh.replace("</asset>", '<unit name="mm" meter="0.001"/></asset>'))
    (tmp_path / "a.urdf").write_text('<robot name="a">' + link("base_link", '<mesh filename="hull.dae"/>') + "</robot>")
    (box,) = UrdfFile(str(tmp_path / "a.urdf"), {}).boxes(["base_link"])
    assert (box[1] - box[0]).tolist() == pytest.approx([0.4, 0.3, 0.1])


def test_a_robot_without_laser_is_asked_for_one(make):
    urdf = TWO[: TWO.index('<link name="scanner">')] + '<xacro:arg default="$(optenv LIDAR 0)" name="with_laser"/>'
    common = COMMON.replace("topic: scan,", "topic: scan, sensor_frame: /mast,")
    status, said, file = make(urdf, **{"costmap_common.yaml": common})
    assert status == 0
    assert re.search(r"no laser: .*; the file takes with_laser:=; it reads LIDAR from the environment\n", said)
    assert yaml.safe_load(file.read_text())["laser"] == {"frame": "mast"}
    assert "laser.range_max [m] range_max of the scans" in said
    assert "  # beams: " in file.read_text()


@pytest.mark.parametrize(
    ("urdf", "more", "line"),
    [
        ("wheels: 2\n", {"head": ""}, "is no XML"),
        ("<sdf/>", {"head": ""}, "outermost tag is <sdf>"),
        ("<joint/>", {}, "cannot be read as URDF"),
        (link("base_footprint", '<box size="1 1 1"/>'), {}, "has no wheels"),
        (TWO + wheel("third", "-.1 0 0"), {}, "driven wheels are left, right, third"),
        (TWO + wheel("side", ".1 0 0", turn="0 1.5707963 0"), {}, "side_joint.* omni base"),
        (TWO.replace('"left"', '"mecanum_left"'), {}, "left_joint is of an omni base"),
        (TWO.replace("continuous", "fixed").replace("-1.5707963", "0"), {}, "left_joint is fixed, .*make"),
        (
            TWO.replace('name="swivel_joint" type="continuous"', 'name="swivel_joint" type="revolute"'),
            {},
            "swivel_joint steers",
        ),
        (TWO + RAYS, {}, "needs the argument reach: give reach:=VALUE"),
        (TWO + "<xacro:lms/>", {}, "xacro refuses it: unknown macro name: xacro:lms"),
        (TWO + "<link name='a'>" * 101 + "</link>" * 101, {}, "over 100 levels of tags"),
        (TWO + joint("base_footprint", "0 0 0", "scanner"), {}, "joints above the link scanner lead back"),
        (TWO + "<link name='loose'/>", {}, "no joint leads to loose, nor to base_footprint: a robot has one root"),
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
        ('<link name="${{9**9**9}}"/>', "takes over 5 s"),
    ],
)
def test_a_xacro_file_runs_no_code_and_is_bounded(make, tmp_path, urdf, line):
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
    urdf, problem, _ = xacro_file.expand(str(tmp_path / "a.xacro"), {}, {})
    assert re.findall('<link name="(.*?)"', urdf) == [str(value) for value in (*wanted.values(), 6)], problem


PLAIN = TWO + RAYS.replace("$(arg reach)", "1.4")
NAMED = "<transmission name='{0}'><joint name='{0}_joint'/></transmission>"
BY_TRANSMISSIONS = PLAIN + wheel("idle_left", "-.15 .05 0") + wheel("idle_right", "-.15 -.05 0")
BY_TRANSMISSIONS += NAMED.format("left") + NAMED.format("right")
MANY_TURNS = '<axis xyz="0 0 1"/><limit lower="-1e16" upper="1e16" effort="1" velocity="1"/>'
SPRUNG = link("arm") + joint("arm", "0 0 0", kind="prismatic", axis="0 0 1") + PLAIN
DRIVE = '<gazebo><plugin name="d" filename="libdiff_drive.so"><leftJoint>left_joint</leftJoint>'
DRIVE += "<rightJoint>right_joint</rightJoint></plugin></gazebo>"


@pytest.mark.parametrize(
    ("urdf", "more"),
    [
        (BY_TRANSMISSIONS, {}),
        (BY_TRANSMISSIONS.replace("transmission", "other") + DRIVE, {}),
        (BY_TRANSMISSIONS.replace("transmission", "other"), {"control.yaml": DIFF_DRIVE}),
        (PLAIN.replace('"roller"', '"omni_wheel"'), {}),
        (PLAIN.replace('<axis xyz="0 0 1"/></joint><link name="right"', MANY_TURNS + '</joint><link name="right"'), {}),
        (
            SPRUNG.replace(
                '<parent link="base_link"/><child link="left"/>', '<parent link="arm"/><child link="left"/>'
            ),
            {},
        ),
        (PLAIN + "<material/><gazebo reference='nothing'><sensor/></gazebo>", {}),
        (PLAIN.replace("continuous", "fixed"), {}),
        ("\n" + PLAIN, {"head": ' \n<?xml version="1.0"?><robot name="crate">', "tail": "</robot>"}),
    ],
    ids=[
        "transmissions",
        "plugin",
        "controller",
        "omni",
        "many turns",
        "sprung",
        "harmless parts",
        "all fixed",
        "blank",
    ],
)
def test_driven_wheels(make, urdf, more):
    status, said, file = make(urdf, **more)
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
    (tmp_path / "package.xml").write_text("<package><name>crate_nav</name></package>")
    monkeypatch.setenv("TURN", "0.7")
    angles = PLANNER.replace("max_vel_theta: 1.5", "max_vel_theta: rad(pi/2)").replace("0.1}", "!degrees 9.0, %s}")
    nested = "robot: {move_base: {NavfnROS: {allow_unknown: $(arg unknown)}}}\nmove_base/planner_frequency: 2.0\n"
    local = LOCAL.replace("odom_comb", "$(arg prefix)odom").replace("width: 5", "width: 5, map_type: voxel")
    angles = angles.replace("x: 0.4", "x: $(optenv SLOW 0.3)").replace(
        "acc_lim_theta: 3.0", "acc_lim_theta: $(env TURN)"
    )
    angles %= 'global_frame_id: "$(find crate_nav)/a"'
    files = {"dwa.yaml": angles, "navfn.yaml": nested.partition("\n")[0], "costmap_local.yaml": local}
    files.update({"rate.yaml": nested.partition("\n")[2], "costmap_global.yaml": "{global_frame: site_map}\n"})
    _, said, file = make(PLAIN, "prefix:=my_", "unknown:=false", **files)
    fill(file)
    robots.reader._read.cache_clear()
    tree = robots.load(str(file.parent)).parameters(with_map=True)
    assert tree["DWAPlannerROS"]["max_vel_theta"] == pytest.approx(1.5707963)
    assert tree["DWAPlannerROS"]["min_vel_theta"] == pytest.approx(0.1570796)
    assert [tree["DWAPlannerROS"][name] for name in ("max_vel_x", "acc_lim_theta")] == [0.3, 0.7]
    assert tree["DWAPlannerROS"]["global_frame_id"] == f"{tmp_path}/a"
    assert (tree["NavfnROS"]["allow_unknown"], tree["planner_frequency"]) == (False, 2.0)
    assert tree["local_costmap"]["global_frame"] == "my_odom"
    assert robots.load(str(file.parent)).frames.map == "site_map"


def test_a_wrong_value_leaves_the_scale_of_worlds_right(make):
    _, said, file = make(PLAIN, **{"dwa.yaml": PLANNER.replace("max_vel_x: 0.4", "max_vel_x: slow")})
    assert "remark: the planner refuses the parameter files: DWAPlannerROS/max_vel_x is 'slow': give a finite" in said
    assert yaml.safe_load(file.read_text())["world_scale"] == pytest.approx(0.28 / 0.53, abs=1e-3)


def test_a_local_planner_that_is_not_here_gives_its_limits_to_one_that_is(make, capsys):
    teb = "Other: {max_vel_x: 0.35, max_vel_theta: 0.9, acc_lim_x: 0.5, acc_lim_theta: 0.6, dt_ref: 0.3}\n"
    for planner in ("teb_local_planner/Other", "nav_core_adapter::LocalPlannerAdapter"):
        _, said, file = make(PLAIN, **{"dwa.yaml": f"base_local_planner: {planner}\n{teb}"})
        assert f"remark: DWAPlannerROS drives here, not {planner}: with the speeds" in said
        fill(file)
        robots.reader._read.cache_clear()
        assert check_robot.main([str(file.parent)]) == 0, capsys.readouterr()
        robot = robots.load(str(file.parent))
        own = robot.parameters()["DWAPlannerROS"]
        assert [own[name] for name in ("max_vel_x", "max_vel_trans", "max_vel_theta")] == [0.35, 0.35, 0.9]
        assert len(default_space(robot.base, robot.body, {"base_local_planner": planner})) > 5
        file.unlink()


@pytest.mark.parametrize(
    "changes",
    [
        {"topic: bumps": "topic: rear, sensor_frame: back"},
        {"  observation_sources": "  z_voxels: 8\n  mark_threshold: 0\n  observation_sources"},
        {"margin: {": "other_layer: {some: 1}\nmargin: {"},
    ],
    ids=["two sensors", "a voxel layer's own", "a layer that is not in use"],
)
def test_what_is_left_out_is_no_error_afterwards(make, capsys, changes):
    common = COMMON
    for old, new in changes.items():
        common = common.replace(old, new)
    _, said, file = make(
        PLAIN, **{"costmap_common.yaml": common, "more.yaml": "TebLocalPlannerROS: {dt_ref: 0.3}\n" + NAVFN}
    )
    fill(file)
    robots.reader._read.cache_clear()
    assert check_robot.main([str(file.parent)]) == 0, capsys.readouterr()
    said = capsys.readouterr().out
    assert "bumper" not in said
    assert "warning" not in said
    assert "TebLocalPlannerROS is not read here" in said


def test_a_robot_that_is_there_is_not_overwritten(make):
    assert make(TWO)[0] == 0
    status, said, _ = make(TWO)
    assert (status, said.count("\n")) == (1, 1)
    assert "robot.yaml is there already" in said
