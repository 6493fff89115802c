"""Tests of open_floor.py: its courses, the reasons of failures, and the check that drives all courses."""

import shutil

import numpy as np
import pytest

import sim_bridge
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import load
from applr_ros1.robots.folder import _read, read
from training.robot import check as check_robot
from training.robot import open_floor
from training.robot.open_floor import Floor, changes, courses

BURGER = load("turtlebot3_burger")
PLANNER = "dwa_local_planner_params_burger.yaml"


def test_the_door_is_wider_than_the_padded_footprint_by_30_cm():
    *_, door = courses(BURGER)
    (left, right) = sorted(door.boxes, key=lambda box: box[0])
    gap = right[0] - right[3] / 2 - (left[0] + left[3] / 2)
    assert (door.name, round(gap, 6)) == ("drive through a door of 0.53 m", 0.21 + 0.02 + 0.3)


def test_goals_lie_within_a_global_costmap_that_rolls(tmp_path):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    old, text = "rolling_window: false, width: 20, height: 20", (folder / "robot.yaml").read_text()
    assert old in text
    for size, farthest in ((2, 0.9), (40, 5.0 * BURGER.world_scale)):
        new = f"rolling_window: true, width: 40, height: {size}"
        (folder / "robot.yaml").write_text(text.replace(old, new))
        _read.cache_clear()
        assert max(world.course.goal[1] for world in courses(read(str(folder)))) == pytest.approx(farthest)


@pytest.mark.parametrize(
    ("file", "old", "new", "course", "why"),
    [
        (PLANNER, "acc_lim_x: 2.5", "acc_lim_x: 0.1", 0, "% of its cycles, mostly by velocity limits"),
        ("robot.yaml", "margin: 0.02", "margin: 0.4", 3, "the collision monitor intervenes"),
        (PLANNER, "occdist_scale: 0.02", "occdist_scale: 5.0", 3, "it turns or stands"),
    ],
)
def test_the_reason_of_a_failed_drive_is_reported(file, old, new, course, why, tmp_path):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new).replace("acc_lim_theta: 3.2", "acc_lim_theta: 0.5"))
    robot = read(str(folder))
    assert why in Floor(robot).drive(courses(robot)[course])


def test_slipping_wheels_are_reported():
    floor = Floor(BURGER)
    floor.simulator = sim_bridge.make("kinematic", robot=BURGER, friction=0.001)
    assert floor.drive(courses(BURGER)[0]).startswith("it moves ")


def test_a_change_counts_in_all_places_and_keeps_to_the_range():
    space, defaults = space_of(BURGER), space_of(BURGER).theta0
    changed = dict(changes(BURGER))
    for words, robot in changed.items():
        theta, name = space_of(robot).theta0, words.split()[1].rpartition("/")[2]
        assert [space.names[i] for i in np.flatnonzero(theta != defaults)] == [name] * (name in space.names)
        assert (space.low <= theta).all()
        assert (theta <= space.high).all()
    speed = changed["set DWAPlannerROS/max_vel_x to 0.11 instead of 0.22"].parameters()["DWAPlannerROS"]
    assert (speed["max_vel_x"], speed["max_vel_trans"]) == (0.11, 0.11)


def test_a_planner_that_only_stands_before_the_door_gets_a_remark_with_the_remedy(capsys):
    """With its default parameters, the Husky does not pass a door that is .3 m wider than its footprint."""
    assert check_robot.main(["husky"]) == 0
    *_, door, remark = capsys.readouterr().out.splitlines()
    assert door.startswith("drive through a door of 0.98 m: it turns or stands")
    arrive = "all four courses succeed if you set DWAPlannerROS/occdist_scale to 0.005 instead of 0.01"
    assert remark == f"remark: like the C++ planner, it does not drive through a door of 0.98 m: {arrive}"


def test_a_monitor_that_stops_it_before_the_door_is_a_wrong_set_up(tmp_path, monkeypatch):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    text = (folder / "robot.yaml").read_text()
    (folder / "robot.yaml").write_text(text.replace("margin: 0.02", "margin: 0.2"))
    robot = read(str(folder))
    monkeypatch.setattr(open_floor, "changes", lambda robot: ())
    drives, (*_, door, error) = open_floor.try_out(robot)
    assert (drives, "door of 0.53 m: the collision monitor intervenes" in door) == (False, True), door
    assert "no change of a single planner parameter helps" in error
