"""Tests of Sensors with a fake clock and no ROS master: scans that wait for transforms, and clocks
that jump back.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1.nodes import sensors as module
from tests.support.nodes import transform

pytest_plugins = ("tests.support.offline_ros",)


@pytest.fixture
def robot(offline_ros):
    """Provide Sensors; time(t) to set the clock [s]; scan(t), tf(t) and odometry(t) to send
    messages with stamp t; lines for the errors in the log.
    """
    callbacks = offline_ros.callbacks
    sensors = module.Sensors(("odom", "odom", "base"), {"scan": "LaserScan"}, {}, "odom")

    def time(t):
        """Set the clock, and return its time."""
        offline_ros.now = t
        return offline_ros.time

    def scan(t, frame="base", ranges=(1.0, 2.0, 3.0)):
        """Send a scan, by default of a laser in the robot's centre."""
        message = LaserScan(
            angle_min=-1.0, angle_increment=1.0, range_min=0.1, range_max=9.0, ranges=list(ranges)
        )
        message.header.stamp = rospy.Time.from_sec(t)
        message.header.frame_id = frame
        callbacks["scan"](message)

    def tf(t):
        """Send the transform of a robot that drives at 1 m/s: its place tells the stamp."""
        odom_to_base = transform("odom", "base", (t - 100.0, 0.0, 0.0), rospy.Time.from_sec(t))
        sensors.transforms.buffer.set_transform(odom_to_base, "/driver")

    def odometry(t, speed=0.5):
        """Send the velocity [m/s]."""
        message = Odometry()
        message.header.stamp = rospy.Time.from_sec(t)
        message.twist.twist.linear.x = speed
        callbacks["odom"](message)

    return SimpleNamespace(
        sensors=sensors,
        time=time,
        scan=scan,
        tf=tf,
        odometry=odometry,
        lines=offline_ros.log["err"],
    )


def stamps_of(robot):
    """Return the stamps [s] of the scans that are new."""
    return [scan.stamp for scan in robot.sensors.observations().values()]


def test_no_scan_is_lost_while_tf_is_late(robot):
    """Scans come at 25 Hz, tf at 50 Hz and 30 ms late. With a poll every 10 ms, each scan is used
    once, in order.
    """
    used_stamps = []
    for poll_number in range(200):
        poll_time = 100.0 + 0.01 * poll_number
        robot.time(poll_time)
        if poll_number % 2 == 0:
            robot.tf(poll_time - 0.03)
        if poll_number % 4 == 0:
            robot.scan(poll_time)
        used_stamps += stamps_of(robot)
    # All of the 50 scans, but perhaps the last one, whose transform is under way.
    assert used_stamps == pytest.approx(100.0 + 0.04 * np.arange(len(used_stamps)))
    assert len(used_stamps) >= 49


def test_a_publisher_ahead_of_the_clock_gives_the_pose_of_now(robot):
    # The latest transform is 0.45 s ahead of the clock. The pose is that of 101 s, one metre on.
    for tf_number in range(20):
        robot.tf(100.5 + 0.05 * tf_number)
    robot_pose = robot.sensors.pose(robot.time(101.0), 0.3)
    assert robot_pose is not None, robot.sensors.pose_trouble
    assert robot_pose[0] == pytest.approx(1.0)
    # A second later, the same transform is too old.
    assert robot.sensors.pose(robot.time(102.0), 0.3) is None
    assert "0.55 s old" in robot.sensors.pose_trouble


@pytest.mark.parametrize(("ahead", "is_usable"), [(2.9, True), (3.1, False)])
def test_localisation_may_be_stamped_three_seconds_ahead_and_a_pose_may_not(
    robot, ahead, is_usable
):
    """amcl stamps its transform ahead, so that it holds until the next one."""
    now = robot.time(101.0)
    sensors = module.Sensors(("odom", "map", "base"), {}, {}, "odom")
    for parent, child in (("map", "odom"), ("odom", "base")):
        stamp = rospy.Time.from_sec(101.0 + ahead)
        link = transform(parent, child, (1.0, 2.0, 0.0), stamp)
        sensors.transforms.buffer.set_transform(link, "/amcl")
    assert (sensors.frame(now, 0.3) is not None) is is_usable
    assert sensors.pose(now, 0.3) is None
    assert f"{ahead:.2f} s ahead of the clock; at most 0.3 s is allowed" in sensors.pose_trouble


def test_topics_are_silent_until_their_first_message(robot):
    assert robot.sensors.silent_topics(besides="") == ["/scan", "/odom"]
    assert robot.sensors.silent_topics(besides="scan") == ["/odom"]
    robot.scan(100.0)
    assert robot.sensors.silent_topics(besides="") == ["/odom"]
    robot.odometry(100.0)
    assert robot.sensors.silent_topics(besides="") == []


@pytest.mark.parametrize("ahead", [9.0, 11.0, 1000.0])
def test_a_transform_stamped_far_ahead_keeps_no_scan_and_no_pose_out(robot, ahead, capfd):
    """tf's own buffer would refuse every transform that is 20 s older than the latest one."""
    used_stamps = []
    for tf_number in range(100):
        seconds = 100.0 + 0.02 * tf_number
        robot.time(seconds)
        robot.tf(seconds)
        if tf_number == 20:
            robot.tf(seconds + ahead)
        robot.scan(seconds)
        used_stamps += stamps_of(robot)
        x, _, _ = robot.sensors.pose(robot.time(seconds), 0.3)
        assert x == pytest.approx(seconds - 100.0, abs=0.01), seconds
    assert used_stamps == pytest.approx(100.0 + 0.02 * np.arange(100))
    assert "TF_OLD_DATA" not in capfd.readouterr().err
    # A transform_tolerance of up to 10 s is no error.
    problem = f"transform odom <- base of /driver ignored: it is stamped {ahead:.2f} s ahead"
    assert [problem in line for line in robot.lines] == ([] if ahead < 10.0 else [True])


@pytest.mark.parametrize(("ahead", "is_used"), [(0.95, True), (1.05, False)])
def test_a_scan_may_be_stamped_a_second_ahead_of_the_clock(robot, ahead, is_used):
    """The clocks of two computers differ a little. Further ahead, a stamp is an error."""
    robot.time(101.0)
    robot.tf(101.0 + ahead)
    robot.scan(101.0 + ahead)
    assert bool(robot.sensors.observations()) is is_used
    # A scan that was used is the latest one. One that was refused keeps no other out.
    robot.tf(101.0)
    robot.scan(101.0)
    assert len(stamps_of(robot)) == (0 if is_used else 1)


def test_the_latest_scan_with_a_transform_is_used_and_later_ones_wait(robot):
    robot.time(101.0)
    robot.tf(100.0)
    robot.tf(100.95)
    # tf knows the pose until 100.95 s, so that the last scan must wait.
    for stamp in (100.9, 100.94, 100.98):
        robot.scan(stamp)
    assert stamps_of(robot) == pytest.approx([100.94])
    robot.tf(101.0)
    assert stamps_of(robot) == pytest.approx([100.98])
    assert stamps_of(robot) == []


def test_scans_without_stamps_get_their_arrival_times(robot):
    for seconds in (100.5, 100.6):
        robot.time(seconds)
        robot.tf(seconds)
        robot.scan(0.0)
        assert stamps_of(robot) == pytest.approx([seconds])


def test_a_line_about_a_scan_has_stamp_age_and_reason(robot):
    assert robot.sensors.describe_latest("scan") == "no message has arrived"
    robot.time(103.0)
    robot.tf(102.9)
    robot.scan(100.0)
    assert robot.sensors.observations() == {}
    stamp_and_age = "the latest message has stamp 100.000, 3.00 s ago; "
    reason = "transform odom <- base at 100.000: "
    assert robot.sensors.describe_latest("scan").startswith(stamp_and_age + reason)


def test_a_line_about_a_scan_names_its_frame_if_lasers_share_the_topic(robot):
    robot.time(103.0)
    robot.scan(100.0, frame="rear")
    robot.scan(102.98, frame="base")
    latest = "the latest message, of frame base, has stamp 102.980, 0.02 s ago"
    assert robot.sensors.describe_latest("scan") == latest


@pytest.mark.parametrize("jump", [0.05, 0.45, 30.0])
def test_after_a_clock_jump_back_the_next_messages_are_used(robot, jump, monkeypatch):
    # Given: messages of the time before, of which one scan waits for its transform
    monkeypatch.setattr(module, "is_wallclock", lambda: False)
    robot.time(100.5)
    clock = module.RosClock()
    assert not clock.went_back()
    robot.tf(100.5)
    robot.odometry(100.5)
    robot.scan(100.5)
    assert robot.sensors.observations()
    assert robot.sensors.pose(rospy.Time.from_sec(100.49), 0.3)[0] == pytest.approx(0.5)
    robot.scan(100.51)

    # When: the clock jumps back
    earlier_time = robot.time(100.5 - jump)
    assert clock.went_back()
    robot.sensors.forget()

    # Then: nothing is left of them. They would count as new for the whole step.
    assert robot.sensors.pose(earlier_time, 0.3) is None
    assert robot.sensors.observations() == {}
    assert robot.sensors.odometry_trouble(earlier_time, 0.5)
    assert robot.sensors.describe_latest("scan") == "no message has arrived"

    # The next messages are used.
    next_time = robot.time(100.52 - jump)
    robot.tf(100.52 - jump)
    robot.odometry(100.52 - jump)
    robot.scan(100.52 - jump)
    assert robot.sensors.pose(next_time, 0.3)[0] == pytest.approx(0.52 - jump)
    assert robot.sensors.observations()
    assert not robot.sensors.odometry_trouble(next_time, 0.5)


def test_a_wall_clock_that_is_adjusted_by_less_than_a_second_did_not_jump(robot, monkeypatch):
    monkeypatch.setattr(module, "is_wallclock", lambda: True)
    clock = module.RosClock()
    begin = clock.now.to_sec()
    robot.time(begin - 0.9)
    assert not clock.went_back()
    # Each step counts by itself.
    robot.time(begin - 1.8)
    assert not clock.went_back()
    robot.time(begin - 2.9)
    assert clock.went_back()


def test_a_velocity_of_which_one_number_is_not_finite_is_ignored(robot):
    robot.odometry(100.0, 0.5)
    robot.odometry(100.1, math.nan)
    assert robot.sensors.twist == (0.5, 0.0)
    assert "its twist (nan, 0.0) is not finite" in robot.lines[-1]


def test_ages_are_those_of_the_messages_in_use(robot):
    assert robot.sensors.ages(robot.time(100.5)) == {}
    robot.tf(100.4)
    robot.tf(100.48)
    robot.odometry(100.45)
    robot.scan(100.42)
    robot.scan(100.49)  # This scan has no transform yet.
    cycle_time = robot.time(100.5)
    robot.sensors.pose(cycle_time, 0.3)
    robot.sensors.observations()
    expected_ages = {"scan_age_s": 0.08, "pose_age_s": 0.02, "twist_age_s": 0.05}
    assert robot.sensors.ages(cycle_time) == pytest.approx(expected_ages)


def test_odometry_without_a_velocity_is_reported_once(robot):
    """The pose in tf moves at 1 m/s."""
    for step in range(100):
        seconds = 100.0 + 0.05 * step
        robot.tf(seconds)
        robot.odometry(seconds, speed=0.0)
        robot.sensors.pose(robot.time(seconds), 0.3)
    problem = "the odometry's velocity is 0 while its pose moves at 1.00 m/s"
    assert problem in robot.sensors.odometry_problem
    assert robot.lines == [f"/odom: {robot.sensors.odometry_problem}"]
    robot.sensors.forget()
    assert robot.sensors.odometry_problem == ""


def test_odometry_that_has_ended_contradicts_no_pose(robot):
    robot.odometry(100.0, speed=0.0)
    for step in range(100):
        seconds = 100.0 + 0.05 * step
        robot.tf(seconds)
        robot.sensors.pose(robot.time(seconds), 0.3)
    assert robot.sensors.odometry_trouble(robot.time(105.0), 1.0)
    assert robot.sensors.odometry_problem == ""
    assert robot.lines == []


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_lasers_that_share_a_topic_are_distinguished_by_their_frames(robot, delay):
    """The rear laser has fewer beams and equal or later stamps, and is used as often as the front
    laser.
    """
    used_scans = []  # frame and number of beams
    for scan_number in range(10):
        front_stamp = 100.0 + 0.1 * scan_number
        rear_stamp = front_stamp + delay
        robot.time(rear_stamp)
        for parent, child in (("odom", "base"), ("base", "rear")):
            for stamp in (front_stamp, rear_stamp):
                parent_to_child = transform(
                    parent, child, (0.0, 0.0, 0.0), rospy.Time.from_sec(stamp)
                )
                robot.sensors.transforms.buffer.set_transform(parent_to_child, "test")
        robot.scan(front_stamp)
        robot.scan(rear_stamp, "rear", (1.0, 2.0))
        for scan in robot.sensors.observations().values():
            used_scans.append((scan.frame, len(scan.ranges)))
        assert robot.sensors.describe_latest("scan").endswith("s ago"), "no trouble"
    # A poll has one scan of a topic: the lasers take turns.
    assert len(used_scans) == 10
    assert used_scans.count(("rear", 2)) == used_scans.count(("base", 3)) == 5


def test_a_silent_laser_does_not_affect_the_other_on_its_topic(robot):
    robot.time(100.0)
    robot.tf(100.0)
    base_to_rear = transform("base", "rear", (0.0, 0.0, 0.0), rospy.Time(100))
    robot.sensors.transforms.buffer.set_transform(base_to_rear, "test")
    robot.scan(100.0, "rear")
    assert robot.sensors.observations()
    for seconds in 100.0 + 0.1 * np.arange(1, 40):
        robot.time(seconds)
        robot.tf(seconds)
        robot.scan(seconds)
        (scan,) = robot.sensors.observations().values()
        assert scan.frame == "base"
        assert scan.stamp == pytest.approx(seconds)
