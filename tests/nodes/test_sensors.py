"""Tests of Sensors with a fake clock and no ROS master: scans that wait for transforms, and clocks
that jump back.
"""

from types import SimpleNamespace

import pytest
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1.nodes import sensors as module
from applr_ros1.nodes import transforms
from tests.support.nodes import transform


@pytest.fixture
def robot(monkeypatch):
    """Provide Sensors; time(t) to set the clock [s]; scan(t), tf(t) and odometry(t) to send
    messages with stamp t.
    """
    callbacks = {}
    clock = [rospy.Time(100)]

    monkeypatch.setattr(
        rospy, "Subscriber", lambda topic, kind, callback, **_: callbacks.update({topic: callback})
    )
    monkeypatch.setattr(rospy, "get_rostime", lambda: clock[0])
    monkeypatch.setattr(rospy, "logerr_throttle", lambda *_: None)
    monkeypatch.setattr(transforms.tf2_ros, "TransformListener", lambda *_, **__: "listens")
    sensors = module.Sensors(("odom", "odom", "base"), {"scan": "LaserScan"}, {}, "odom")

    def time(t):
        clock[0] = rospy.Time.from_sec(t)
        return clock[0]

    def scan(t, frame="base", ranges=(1.0, 2.0, 3.0)):
        message = LaserScan(
            angle_min=-1.0, angle_increment=1.0, range_min=0.1, range_max=9.0, ranges=list(ranges)
        )
        message.header.stamp = rospy.Time.from_sec(t)
        message.header.frame_id = frame
        callbacks["scan"](message)

    def tf(t):
        placed = transform("odom", "base", (t - 100.0, 0.0, 0.0), rospy.Time.from_sec(t))
        sensors.transforms.buffer.set_transform(placed, "test")

    def odometry(t):
        message = Odometry()
        message.header.stamp = rospy.Time.from_sec(t)
        message.twist.twist.linear.x = 0.5
        callbacks["odom"](message)

    return SimpleNamespace(sensors=sensors, time=time, scan=scan, tf=tf, odometry=odometry)


def test_no_scan_is_lost_while_tf_is_late(robot):
    """Scans come at 25 Hz, tf at 50 Hz and 30 ms late. With a poll every 10 ms, each scan is used
    once, in order.
    """
    used = []
    for k in range(200):
        now = 100.0 + 0.01 * k
        robot.time(now)
        if k % 2 == 0:
            robot.tf(now - 0.03)
        if k % 4 == 0:
            robot.scan(now)
        used += [scan.stamp for scan in robot.sensors.observations().values()]
    assert used == pytest.approx([100.0 + 0.04 * k for k in range(len(used))])
    assert len(used) >= 49


def test_a_publisher_ahead_of_the_clock_gives_the_pose_of_now(robot):
    for k in range(20):
        robot.tf(100.5 + 0.05 * k)
    pose = robot.sensors.pose(robot.time(101.0), 0.3)
    assert pose is not None, robot.sensors.pose_trouble
    assert pose[0] == pytest.approx(1.0)
    assert robot.sensors.pose(robot.time(102.0), 0.3) is None
    assert "0.55 s old" in robot.sensors.pose_trouble


def test_the_latest_scan_with_a_transform_is_used_and_later_ones_wait(robot):
    robot.time(101.0)
    robot.tf(100.0)
    robot.tf(100.95)
    for time in (100.9, 100.94, 100.98):
        robot.scan(time)
    assert [scan.stamp for scan in robot.sensors.observations().values()] == pytest.approx([100.94])
    robot.tf(101.0)
    assert [scan.stamp for scan in robot.sensors.observations().values()] == pytest.approx([100.98])
    assert robot.sensors.observations() == {}


def test_scans_without_stamps_get_their_arrival_times(robot):
    for now in (100.5, 100.6):
        robot.time(now)
        robot.tf(now)
        robot.scan(0.0)
        assert [scan.stamp for scan in robot.sensors.observations().values()] == [
            pytest.approx(now)
        ]


def test_a_line_about_a_scan_has_stamp_age_and_reason(robot):
    assert robot.sensors.describe_latest("scan") == "no message has arrived"
    robot.time(103.0)
    robot.tf(102.9)
    robot.scan(100.0)
    assert robot.sensors.observations() == {}
    begin = "the latest message has stamp 100.000, 3.00 s ago; transform odom <- base at 100.000: "
    assert robot.sensors.describe_latest("scan").startswith(begin)


@pytest.mark.parametrize("step", [0.05, 0.45, 30.0])
def test_after_a_clock_jump_back_the_next_messages_are_used(robot, step, monkeypatch):
    monkeypatch.setattr(module, "is_wallclock", lambda: False)
    robot.time(100.5)
    clock = module.Clock()
    assert not clock.went_back()
    robot.tf(100.5)
    robot.odometry(100.5)
    robot.scan(100.5)
    assert robot.sensors.observations()
    assert robot.sensors.pose(rospy.Time.from_sec(100.49), 0.3)[0] == pytest.approx(0.5)
    robot.scan(100.51)  # This scan waits for its transform.
    now = robot.time(100.5 - step)
    assert clock.went_back()
    robot.sensors.forget()
    assert robot.sensors.pose(now, 0.3) is None
    assert robot.sensors.observations() == {}
    assert robot.sensors.odometry_trouble(now, 0.5)
    now = robot.time(100.52 - step)
    robot.tf(100.52 - step)
    robot.odometry(100.52 - step)
    robot.scan(100.52 - step)
    assert robot.sensors.pose(now, 0.3)[0] == pytest.approx(0.52 - step)
    assert robot.sensors.observations()
    assert not robot.sensors.odometry_trouble(now, 0.5)


def test_ages_are_those_of_the_messages_in_use(robot):
    assert robot.sensors.ages(robot.time(100.5)) == {}
    robot.tf(100.4)
    robot.tf(100.48)
    robot.odometry(100.45)
    for time in (100.42, 100.49):  # The second scan has no transform yet.
        robot.scan(time)
    now = robot.time(100.5)
    robot.sensors.pose(now, 0.3)
    robot.sensors.observations()
    assert robot.sensors.ages(now) == pytest.approx(
        {"scan_age_s": 0.08, "pose_age_s": 0.02, "twist_age_s": 0.05}
    )


@pytest.mark.parametrize("later", [0.0, 0.02])
def test_lasers_that_share_a_topic_are_distinguished_by_their_frames(robot, later):
    """The rear laser has fewer beams and equal or later stamps, and is used as often as the front
    laser.
    """
    used = []
    for k in range(10):
        now = 100.0 + 0.1 * k
        robot.time(now + later)
        for frame, child in (("odom", "base"), ("base", "rear")):
            placed = transform(frame, child, (0.0, 0.0, 0.0), rospy.Time.from_sec(now))
            for stamp in (now, now + later):
                placed.header.stamp = rospy.Time.from_sec(stamp)
                robot.sensors.transforms.buffer.set_transform(placed, "test")
        robot.scan(now)
        robot.scan(now + later, "rear", (1.0, 2.0))
        used += [(scan.frame, len(scan.ranges)) for scan in robot.sensors.observations().values()]
        assert not robot.sensors._topics["scan"].trouble
    assert len(used) == 10
    assert used.count(("rear", 2)) == used.count(("base", 3)) == 5


def test_a_silent_laser_does_not_affect_the_other_on_its_topic(robot):
    robot.time(100.0)
    robot.tf(100.0)
    robot.sensors.transforms.buffer.set_transform(
        transform("base", "rear", (0.0, 0.0, 0.0), rospy.Time(100)), "test"
    )
    robot.scan(100.0, "rear")
    assert robot.sensors.observations()
    for k in range(1, 40):
        robot.time(100.0 + 0.1 * k)
        robot.tf(100.0 + 0.1 * k)
        robot.scan(100.0 + 0.1 * k)
        (scan,) = robot.sensors.observations().values()
        assert (scan.frame, scan.stamp) == ("base", pytest.approx(100.0 + 0.1 * k))
