"""Teleoperation: what keys and sticks become, and a live node whose bag is a demonstration."""

import os
import struct

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.tools.teleop_input import Joystick, Keyboard, VelocitySmoother
from tests.support import ROOT


def drive(smoother, seconds, now=0.0, dt=0.05, key=""):
    """Commands for some seconds, with a key held."""
    command = 0.0, 0.0
    for i in range(int(round(seconds / dt))):
        if key:
            smoother.key(key, now + i * dt)
        command = smoother.command(now + i * dt, dt)
    return command


def test_held_key_drives_smoothly_and_a_key_let_go_stops():
    smoother = VelocitySmoother(speed=0.5, turn=1.0)
    smoother.key("i", 0.0)
    assert smoother.command(0.0, 0.05) == pytest.approx((0.05, 0.0))  # 1 m/s^2
    assert drive(smoother, 2.0, 0.05, key="i") == pytest.approx((0.5, 0.0))
    assert drive(smoother, 0.5, 2.05) == pytest.approx((0.5, 0.0))  # a terminal repeats late
    assert drive(smoother, 1.0, 2.55) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "signs"),
    [
        ("o", (1, -1)),
        ("j", (0, 1)),
        ("m", (-1, -1)),
        ("k", (0, 0)),
    ],
)
def test_keys(key, signs):
    assert drive(VelocitySmoother(0.4, 0.8), 2.0, key=key) == pytest.approx((0.4 * signs[0], 0.8 * signs[1]))


def test_speed_keys_stay_within_limits_and_end_keys_end():
    smoother = VelocitySmoother()
    for _ in range(60):
        assert smoother.key("q", 0.0)
    assert (smoother.speed, smoother.turn) == (2.0, 4.0)
    for _ in range(90):
        smoother.key("z", 0.0)
    assert (smoother.speed, smoother.turn) == (0.05, 0.1)
    assert not smoother.key("\x1b", 0.0)
    assert smoother.command(0.0, 1.0) == (0.0, 0.0)


def test_a_stick_that_does_not_count_and_one_that_falls_silent():
    for stick in ((1.0, 0.0, False), (float("nan"), 0.0, True), (0.05, 0.05, True), (3.0, 0.0, True)):
        smoother = VelocitySmoother()
        smoother.stick(*stick, 0.0)
        assert smoother.command(0.0, 1.0) == (0.0, 0.0)
    smoother = VelocitySmoother(1.0, 1.0)
    smoother.stick(0.5, -0.5, True, 0.0)
    assert drive(smoother, 0.55) == pytest.approx((0.5, -0.5))
    assert drive(smoother, 1.0, 0.6) == (0.0, 0.0)


def test_joystick_device(tmp_path):
    path = tmp_path / "js0"
    os.mkfifo(path)
    stick = Joystick(str(path))
    with open(path, "wb", buffering=0) as device:
        for value, kind, number in ((-32767, 0x82, 1), (16384, 2, 0), (1, 1, 4), (-20000, 2, 1)):
            device.write(struct.pack("<IhBB", 0, value, kind, number))
        stick.read()
    assert stick.buttons == {4: 1}
    assert stick.axes == pytest.approx({1: 20000 / 32767, 0: -16384 / 32767})


def test_devices_that_are_not_there_are_named():
    with pytest.raises(OSError, match="/nowhere/js0"):
        Joystick("/nowhere/js0")
    with open(os.devnull) as given, pytest.raises(ApplrError, match="no terminal"):
        Keyboard(given)


def test_keyboard_of_a_terminal():
    import pty

    master, slave = pty.openpty()
    with os.fdopen(slave, "rb") as terminal, Keyboard(terminal) as keyboard:
        for typed, heard in (
            *((b"ik", "ik"), (b"\x1b[A", ""), (b"\x1b", "\x1b")),
            *((b"i\x1b[A", "i"), (b"\x1b[1;5Cik", "ik"), (b"\x1bOP", ""), (b"i\x1b[3~\x1b[Bk", "ik")),
        ):
            os.write(master, typed)
            assert keyboard.read() == heard
        assert keyboard.read() == ""
    os.close(master)


@pytest.mark.ros
def test_node_drives_and_records(tmp_path):
    """A joystick drives for a few seconds; the bag is a demonstration by a person."""
    pytest.importorskip("rospy")
    pytest.importorskip("rosbags")
    import rospy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Joy, LaserScan

    from tests.support.ros_harness import session, wait_for
    from training.baselines.appld import demonstration

    ros, bag, commands = session(), tmp_path / "drive.bag", []
    scans = rospy.Publisher("/front/scan", LaserScan, queue_size=5)
    odometry = rospy.Publisher("/odometry/filtered", Odometry, queue_size=5)
    joy = rospy.Publisher("/joy", Joy, queue_size=5)
    rospy.Subscriber("/cmd_vel", Twist, lambda message: commands.append((message.linear.x, message.angular.z)))
    recorder = ros.python("-m", "applr_ros1.scripts.record", str(bag))
    node = ros.python("-m", "applr_ros1.scripts.teleop", "_input:=joystick", "_speed:=1.0")
    wait_for(lambda: "ready" in node.text or not node.alive(), 10.0, "teleop")
    wait_for(lambda: scans.get_num_connections() and odometry.get_num_connections() and joy.get_num_connections(), 5.0)
    scan = LaserScan(
        angle_min=-2.35619,
        angle_max=2.35619,
        angle_increment=2 * 2.35619 / 719,
        range_min=0.1,
        range_max=30.0,
        ranges=[1.0] * 720,
    )
    pose = Odometry(child_frame_id="base_link")
    pose.header.frame_id, pose.pose.pose.orientation.w = "odom", 1.0
    for i in range(45):
        scan.header.stamp = pose.header.stamp = rospy.Time.now()
        pose.pose.pose.position.x = 0.04 * i
        scans.publish(scan)
        odometry.publish(pose)
        joy.publish(Joy(axes=[0.0, 0.5], buttons=[0, 0, 0, 0, 1]))
        rospy.sleep(0.04)
    assert node.end() == 0, node.text
    wait_for(lambda: commands[-1] == (0.0, 0.0), 2.0, "the robot stands")
    recorder.end()
    wait_for(bag.exists, 5.0, "the bag")
    assert max(v for v, _ in commands) == pytest.approx(0.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstration, "SHORTEST", 1.0)
        found = demonstration.read_demonstration(bag)
    assert found.source == {"demonstrator": "a person, by joystick"}
    assert found.command[:, 0].max() == pytest.approx(0.5)
    assert found.ranges.shape[1] == 720
    assert found.goal == tuple(found.pose[-1])  # nobody sent one


@pytest.mark.ros
def test_a_terminal_that_is_closed_ends_the_drive():
    """The robot is told to stand."""
    pytest.importorskip("rospy")
    import fcntl
    import pty
    import subprocess
    import sys
    import termios

    import rospy
    from geometry_msgs.msg import Twist

    from tests.support.ros_harness import session, wait_for

    ros, commands = session(), []
    heard = rospy.Subscriber("/cmd_vel", Twist, lambda message: commands.append(message.linear.x))
    master, slave = pty.openpty()
    node = subprocess.Popen(
        [sys.executable, "-m", "applr_ros1.scripts.teleop", "_input:=keyboard"],
        env=ros.env,
        cwd=ROOT,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )
    os.close(slave)
    wait_for(heard.get_num_connections, 10.0, "teleop")
    wait_for(lambda: os.write(master, b"i") and commands and commands[-1] > 0.0, 5.0, "the robot drives")
    os.close(master)
    assert node.wait(10.0) == 0
    wait_for(lambda: commands[-1] == 0.0, 2.0, "the robot stands")
