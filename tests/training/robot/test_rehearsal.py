"""Tests of what a recorded drive says of a robot's sensors: `./applr check --bag`."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import quaternion_of
from applr_ros1.drives.drive import Drive, Measured, Motion, Scans, Transforms
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.support.bags import write
from training.robot import check, open_floor
from training.robot.rehearsal import WORDS, lines, rehearsed

SECONDS = 6.0
SPEED = 0.5  # [m/s]
# Room of 8 x 4 m with a pillar: boxes (x, y, yaw, length, width)
ROOM = np.array(
    [
        [2.0, 2.1, 0.0, 8.2, 0.2],
        [2.0, -2.1, 0.0, 8.2, 0.2],
        [6.1, 0.0, 0.0, 0.2, 4.4],
        [-2.1, 0.0, 0.0, 0.2, 4.4],
        [3.0, 1.2, 0.5, 0.4, 0.4],
    ]
)


def room_drive(noise=0.003, y=0.0, zeros=0.0, gap=0.0, elsewhere=False, laser=JACKAL.laser):
    """Return a drive through a room, straight on.

    Args:
        noise: Standard deviation of the ranges [m].
        y: Where [m].
        zeros: Share of the ranges that are 0.
        gap: Time without scans in the middle [s].
        elsewhere: Whether every tenth scan is one of a robot across the way.
        laser: The robot's laser.
    """
    rng = np.random.default_rng(0)
    time = np.arange(0.0, SECONDS, 0.02)
    pose = np.outer(time, [SPEED, 0.0, 0.0]) + [0.0, y, 0.0]
    twist = np.tile([SPEED, 0.0], (len(time), 1))
    stamps = np.arange(0.05, SECONDS, 0.05)
    stamps = stamps[abs(stamps - SECONDS / 2) >= gap / 2]
    lidar = Lidar(laser, np.zeros((0, 3)), ROOM)
    ranges = []
    for number, stamp in enumerate(stamps):
        yaw = 0.5 * np.pi if elsewhere and number % 10 == 9 else 0.0
        seen = lidar.scan(*laser.pose_for((SPEED * stamp, y, yaw))).copy()
        seen += rng.normal(0.0, noise, seen.shape).astype(np.float32)
        seen[rng.random(len(seen)) < zeros] = 0.0
        ranges.append(seen)
    return Drive(
        odometry=Motion(time, time, pose, twist),
        scans=Scans(stamps, stamps, np.tile(laser.fan, (len(stamps), 1)), ranges),
    )


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ({}, ""),
        ({"zeros": 0.31}, "zeros"),
        ({"gap": 0.8}, "gap"),
        ({"noise": 0.05}, "noise"),
        ({"elsewhere": True}, "elsewhere"),
    ],
)
def test_a_recorded_drive_names_its_fault_with_a_remedy(fault, named):
    figures = rehearsed(*room_drive(**fault).require(Measured), JACKAL)
    said = "\n".join(lines(figures))
    for _, name, _, remedy in WORDS:
        # One fault may lead to others: gaps, noise and jumps of the scans to scans without a match.
        if not fault or name == named:
            assert (remedy in said) == (name == named), said
    if not fault:
        assert figures["pass"] > 0.98
        assert figures["rate"] == pytest.approx(20.0)
        assert figures["noise"] == pytest.approx(0.003, rel=0.2)


def test_a_check_says_what_the_sensors_show_in_a_bag(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(open_floor, "try_out", lambda robot: (True, []))
    bag = write(tmp_path / "drive.bag", room_drive(zeros=0.31))
    assert check.main(["jackal", "--bag", str(bag)]) == 0
    remedy = "if the laser sends 0 without a return, set laser.no_return to 0.0"
    assert f"{bag}: 31% of the ranges are 0: {remedy}" in capsys.readouterr().out
    assert check.main(["turtlebot3_burger", "--bag", str(bag)]) == 1
    assert f"{bag}: no messages on /odom: correct topics" in capsys.readouterr().err
    # A robot whose description has it has no zeros.
    laser = JACKAL.laser.model_copy(update={"no_return": 0.0})
    assert "0% of the ranges are 0" in check.drive_lines(replace(JACKAL, laser=laser), bag)[3]


def test_a_check_says_that_a_bag_has_another_laser_and_takes_its_place_from_tf(tmp_path):
    # Beside a wall, which is ahead by the place in robot.yaml
    turned = {"pose": (0.06, 0.0, -1.5), "beams": 181, "range_max": 12.0}
    drive = room_drive(y=-1.6, laser=JACKAL.laser.model_copy(update=turned))
    place = np.array([[0.06, 0.0, 0.0, *quaternion_of(-1.5)]])
    drive.transforms = Transforms(
        np.zeros(1), np.zeros(1), ["base_link"], ["front_laser"], place, [True]
    )
    fan, in_tf, *said = check.drive_lines(JACKAL, write(tmp_path / "drive.bag", drive))
    assert fan.endswith(
        "laser: 181 beams, -135 to 135 degrees, 0.1 to 12 m; robot.yaml has 720 beams, -135 to 135 "
        "degrees, 0.1 to 30 m: correct laser there, or give the robot that drove"
    )
    assert "tf has the laser at (0.06, 0.00) m, -1.50 rad" in in_tf
    assert ": check" not in "".join(said)
