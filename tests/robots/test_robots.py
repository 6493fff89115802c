"""Robot descriptions: the four that are included, and one line for each way in which one can be wrong."""

import os
import shutil

import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.check import complete
from tests.support.jackal import JACKAL

HERE = os.path.dirname(robots.load("jackal").folder)


@pytest.mark.parametrize("name", robots.NAMES)
def test_shipped_robot_is_whole(name):
    robot = robots.load(name)
    assert robot.name == name
    assert robot is robots.load(robot.folder)
    for parameter in robot.space:
        start = robot.start_value(parameter)
        assert start is None or parameter.low <= start <= parameter.high
    for costmap in ("local_costmap", "global_costmap"):
        assert robot.parameters()[costmap]["global_frame"] == "odom"
    if name != "jackal":
        assert robot.parameters(with_map=True)["global_costmap"]["global_frame"] == "map"


def test_the_husky_turns_in_place_as_its_planner_does_by_default():
    """Its maker's files give the slowest turn under a name that DWAPlannerROS does not read."""
    tree = robots.load("husky").parameters()
    files = complete(tree)["DWAPlannerROS"]
    del tree["DWAPlannerROS"]["min_vel_theta"]
    assert files["min_vel_theta"] == complete(tree)["DWAPlannerROS"]["min_vel_theta"] == 0.4


def test_jackal_has_the_files_and_ranges_of_the_authors():
    def covers(large, small):
        return all(covers(large[k], v) if isinstance(v, dict) else large[k] == v for k, v in small.items())

    jackal = robots.load("jackal")
    given = jackal.parameters()
    given["TrajectoryPlannerROS"].pop("y_vels", None)
    assert covers(JACKAL, given)
    assert [(p.name, p.low, p.high, p.integer) for p in jackal.space] == [
        ("max_vel_x", 0.2, 2.0, False),
        ("max_vel_theta", 0.314, 3.14, False),
        ("vx_samples", 4, 20, True),
        ("vtheta_samples", 4, 60, True),
        ("occdist_scale", 0.05, 1.0, False),
        ("pdist_scale", 0.1, 1.5, False),
        ("gdist_scale", 0.1, 2.0, False),
        ("inflation_radius", 0.1, 0.6, False),
    ]
    assert [jackal.start_value(p) for p in jackal.space] == [0.5, 1.57, 6, 20, 0.1, 0.75, 1.0, 0.3]
    with pytest.raises(ApplrError, match="no move_base.with_map"):
        jackal.parameters(with_map=True)


def changed(path, *keys_and_value):
    """A change of robot.yaml for the test below: the value at a path of keys, or its removal (no value)."""

    def change(description):
        here = description
        keys = [int(key) if key.isdigit() else key for key in path.split(".")]
        for key in keys[:-1]:
            here = here[key]
        if keys_and_value:
            here[keys[-1]] = keys_and_value[0]
        else:
            del here[keys[-1]]

    return change


WRONG = [
    (changed("laser.beams"), "laser.beams is missing"),
    (changed("base.colour", "red"), "base.colour is unknown: there are drive, max_speed"),
    (changed("base.drive", "omni"), "base.drive is 'omni': give 'skid_steer' or 'two_wheel'"),
    (changed("base.max_speed", float("nan")), "base.max_speed is nan: give a finite number"),
    (changed("base.wheelbase"), "base.wheelbase is missing"),
    (changed("laser.last_angle", -3.0), "laser.last_angle is -3: give more than first_angle"),
    (changed("laser.beams", 720.5), "laser.beams is 720.5: give a valid integer"),
    (changed("laser.pose", [0.1]), "laser.pose is [0.1]: give more numbers"),
    (changed("laser.frame", "two words"), "laser.frame is 'two words': give a name"),
    (
        changed("monitor.deceleration", 30.0),
        "monitor.deceleration is 30: the base brakes with base.max_acceleration 20",
    ),
    (changed("base.max_speed", 1.5), "max_vel_x.range is [0.2, 2]: base.max_speed of this base is 1.5, stay within it"),
    (changed("parameter_space.vx_samples.range", [8, 20]), "the parameter files start with 6, include it"),
    (changed("parameter_space.vx_samples.sets", []), "vx_samples.sets is []: give at least 1"),
    (changed("move_base.files.0", {"file": "../../x.yaml"}), "give the name of a file in the robot's folder"),
    (changed("move_base.files.0", {"file": "none.yaml"}), "none.yaml: cannot be read"),
    (changed("frames.base", "base_footprint"), "robot_base_frame is base_link in the parameter files"),
]


@pytest.mark.parametrize(("change", "line"), WRONG, ids=[line[:40] for _, line in WRONG])
def test_wrong_description_is_one_line(tmp_path, change, line):
    folder = tmp_path / "mine"
    shutil.copytree(os.path.join(HERE, "jackal"), folder)
    description = yaml.safe_load((folder / "robot.yaml").read_text())
    change(description)
    (folder / "robot.yaml").write_text(yaml.safe_dump(description))
    with pytest.raises(ApplrError) as found:
        robots.load(str(folder))
    assert line in str(found.value)
    assert "\n" not in str(found.value)
    assert str(folder) in str(found.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("base: {drive: [", "not readable as YAML"),
        ("a: !!python/object/apply:os.system [true]\n", "could not determine a constructor"),
        ("- 1\n", "holds no mapping"),
        ("[" * 5000, "not readable as YAML"),
        ("#" * 2**18, "bytes are too many"),
    ],
)
def test_damaged_file_is_one_line(tmp_path, text, line):
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(ApplrError) as found:
        robots.load(str(tmp_path))
    assert line in str(found.value)
    assert "\n" not in str(found.value)


def with_files(folder, **files):
    """A copy of the Jackal's description whose further parameter files have these texts, {name: (text, namespace)}."""
    shutil.copytree(os.path.join(HERE, "jackal"), folder)
    description = yaml.safe_load((folder / "robot.yaml").read_text())
    for name, (text, namespace) in files.items():
        (folder / (name + ".yaml")).write_text(text)
        description["move_base"]["files"].append({"file": name + ".yaml", "namespace": namespace})
    (folder / "robot.yaml").write_text(yaml.safe_dump(description))
    return str(folder)


def test_an_empty_section_of_a_file_holds_nothing(tmp_path):
    empty, value = ("new:\nlocal_costmap:\n", ""), ("width: 7\n", "new")
    tree = robots.load(with_files(tmp_path / "mine", empty=empty, value=value)).parameters()
    assert tree["new"] == {"width": 7}
    assert tree["local_costmap"] == robots.load("jackal").parameters()["local_costmap"]


def test_a_file_that_does_not_fit_the_others_is_one_line(tmp_path):
    text = "TrajectoryPlannerROS: {max_vel_x: 3.0}\n"
    line = "TrajectoryPlannerROS/max_vel_x is 3 in the parameter files: base.max_speed is 2"
    with pytest.raises(ApplrError) as found:
        robots.load(with_files(tmp_path / "mine", first=(text, ""), second=("width: 7\n", "new/below")))
    assert line in str(found.value)
    assert "\n" not in str(found.value)


def test_unknown_name_lists_the_robots():
    with pytest.raises(ApplrError, match="robot roomba: give husky, jackal, .* or a folder with robot.yaml"):
        robots.load("roomba")
