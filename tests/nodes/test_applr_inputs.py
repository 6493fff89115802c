"""Tests of the inputs of the applr node (plans of the current goal, recent poses), without a ROS
master.
"""

import math

import numpy as np
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from applr_ros1.msg import Movers
from geometry_msgs.msg import PoseStamped, Quaternion
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan

from applr_ros1.nodes import transforms as module
from applr_ros1.nodes.applr.inputs import RobotInputs
from applr_ros1.policy.observation import ObservationError
from tests.support.nodes import transform
from tests.support.refusals import refused

pytest_plugins = ("tests.support.offline_ros",)
PLAN = "/move_base/NavfnROS/plan"


def stamped(message, stamp, frame):
    """Return a message with a stamp and a frame in its header."""
    message.header.stamp = stamp
    message.header.frame_id = frame
    return message


class Beside:
    """Fixture around RobotInputs: sends messages.

    Odometry messages contain another pose (x = 9 m) than tf, so that a test detects which one is
    used.
    """

    def __init__(self, ros):
        self.ros = ros
        self.callbacks = ros.callbacks
        self.inputs = RobotInputs()
        self.buffer = ros.tf
        self.place("odom", "base_link", (0.0, 0.0, 0.0), rospy.Time(0))
        self.place("base_link", "front_laser", (0.1, 0.0, 0.5), rospy.Time(0))

    @property
    def time(self):
        return self.ros.time

    def wait(self, seconds):
        """Let some time pass."""
        self.ros.now += seconds

    def goal(self, name, x):
        """Send a goal x [m] ahead, and the status that has it."""
        message = stamped(PoseStamped(), self.time, "odom")
        message.pose.position.x = x
        self.callbacks["/move_base/current_goal"](message)
        self.status(name)

    def status(self, name):
        """Send a status in which a goal is active."""
        status = GoalStatus(status=GoalStatus.ACTIVE)
        status.goal_id.id = name
        self.callbacks["/move_base/status"](GoalStatusArray(status_list=[status]))

    def place(self, parent, child, pose, stamp):
        """Publish a transform; without a stamp, it is static."""
        parent_to_child = transform(parent, child, pose, stamp)
        if stamp.is_zero():
            self.buffer.set_transform_static(parent_to_child, "test")
        else:
            self.buffer.set_transform(parent_to_child, "test")

    def mount(self, roll, yaw):
        """Mount the laser with a roll, turned by a yaw [rad]."""
        base_to_laser = transform("base_link", "front_laser", (0.1, 0.0, 0.0), rospy.Time(0))
        # Product of the quaternions of the rotation about z and of the one about x before it
        roll_x = math.sin(roll / 2)
        roll_w = math.cos(roll / 2)
        yaw_z = math.sin(yaw / 2)
        yaw_w = math.cos(yaw / 2)
        base_to_laser.transform.rotation = Quaternion(
            x=roll_x * yaw_w,
            y=roll_x * yaw_z,
            z=roll_w * yaw_z,
            w=roll_w * yaw_w,
        )
        self.buffer.set_transform_static(base_to_laser, "test")

    def plan(self, end, frame="odom"):
        """Send a plan along x from 0 to `end` [m]."""
        message = stamped(Path(), self.time, frame)
        for x in np.linspace(0.0, end, 5):
            message.poses.append(PoseStamped())
            message.poses[-1].pose.position.x = x
        self.callbacks[PLAN](message)

    def snapshot(self, scanned=None, odometer=True):
        """Send a scan, by default of now, and odometry, and return what the node has then."""
        # The last beam differs, so that a test sees where it goes.
        scan = LaserScan(
            angle_min=-2.5,
            angle_increment=0.01,
            range_min=0.1,
            range_max=30.0,
            ranges=[1.0] * 500 + [2.0],
        )
        stamp = self.time if scanned is None else scanned
        self.callbacks["front/scan"](stamped(scan, stamp, "front_laser"))
        odometry = stamped(Odometry(child_frame_id="wheels"), self.time, "odom")
        odometry.pose.pose.position.x = 9.0
        odometry.twist.twist.linear.x = 0.5
        if odometer:
            self.callbacks["odometry/filtered"](odometry)
        return self.inputs.snapshot(self.time, self.time.to_sec() - 3.0)


@pytest.fixture
def beside(offline_ros):
    """Return RobotInputs and what is around them."""
    return Beside(offline_ros)


def test_a_decision_waits_for_the_plan_to_the_present_goal(beside):
    beside.goal("one", 5.0)
    beside.plan(5.0)
    assert beside.snapshot().seen.plan[-1, 0] == 5.0
    # A scan without a stamp counts as taken now.
    assert beside.snapshot(rospy.Time(0)).scan_stamp == beside.time
    beside.plan(4.8)
    beside.callbacks[PLAN](Path())  # Planning has failed, so the plan stays.
    beside.wait(0.6)
    beside.status("one")  # The goal is still the same.
    inputs = beside.snapshot().seen
    assert inputs.time == 3.0
    assert inputs.goal == (5.0, 0.0, 0.0)

    # Another goal
    beside.plan(5.0)
    beside.wait(0.02)
    beside.goal("two", -3.0)
    refused(lambda: beside.snapshot(), "no global plan for this goal", kind=ObservationError)
    beside.wait(0.02)
    beside.plan(5.0)  # This plan was under way when the goal changed.
    refused(lambda: beside.snapshot(), "no global plan for this goal", kind=ObservationError)
    beside.plan(-2.8)  # The plan ends at the free cell nearest to the goal.
    assert beside.snapshot().seen.plan[-1, 0] == pytest.approx(-2.8)
    beside.wait(0.6)

    # The plan is older than this goal, although it leads there.
    beside.goal("three", -3.0)
    refused(lambda: beside.snapshot(), "no global plan for this goal", kind=ObservationError)

    # It is newer than the goal, so it is used, although it ends nearer to the previous goal.
    beside.goal("four", 6.0)
    beside.wait(0.6)
    beside.plan(1.0)
    assert beside.snapshot().seen.plan[-1, 0] == 1.0

    # Only its end tells for which of two goals a plan is: on its way it passes the former one.
    beside.goal("five", 1.0)
    beside.wait(0.6)
    beside.goal("six", 5.0)
    beside.plan(5.0)
    assert beside.snapshot().seen.plan[-1, 0] == 5.0


def test_a_node_that_starts_after_a_goal_was_sent_takes_the_end_of_its_plan(beside):
    beside.status("one")
    beside.plan(5.0)
    assert beside.snapshot().seen.goal == (5.0, 0.0, 0.0)


def test_a_goal_ends_when_move_base_has_been_silent_for_two_seconds(beside):
    beside.goal("one", 5.0)
    beside.wait(1.9)
    assert beside.inputs.goal(beside.time) == "one"
    assert not beside.inputs.has_lost_move_base(beside.time)
    beside.wait(0.2)
    assert beside.inputs.goal(beside.time) is None
    assert beside.inputs.has_lost_move_base(beside.time)


def test_the_pose_is_from_tf_at_the_scans_stamp_and_the_twist_from_the_odometry(beside):
    beside.goal("one", 5.0)
    for x in (1.0, 2.0):
        beside.place("world", "odom", (x, 0.0, 0.25), beside.time)
        beside.wait(0.2)
    # Poses at 1 m and 2 m, 0.4 s and 0.2 s ago: a scan between them has the pose in between, and a
    # later one the latest.
    for scan_age, robot_x in ((0.3, 1.5), (0.2, 2.0), (0.0, 2.0)):
        # tf2 accepts no frame with a slash in front, but ROS 1's messages may have it.
        for frame in ("world", "/world"):
            beside.plan(5.0, frame)
            snapshot = beside.snapshot(rospy.Time.from_sec(beside.ros.now - scan_age))
            assert snapshot.seen.pose == pytest.approx((robot_x, 0.0, 0.25))
            assert snapshot.seen.twist == (0.5, 0.0)


def test_a_stale_localisation_prevents_decisions(beside):
    beside.goal("one", 5.0)
    beside.plan(5.0, "map")
    beside.place("map", "odom", (0.0, 0.5, 0.0), beside.time)
    beside.wait(0.9)
    assert beside.snapshot().seen.pose == (0.0, 0.5, 0.0)
    beside.wait(0.2)
    refused(lambda: beside.snapshot(), r"map <- base_link is 1.10 s old", kind=ObservationError)


def test_a_silent_odometry_prevents_decisions(beside):
    beside.plan(5.0)
    beside.snapshot()
    beside.wait(1.1)
    refused(lambda: beside.snapshot(odometer=False), "odometry", kind=ObservationError)


def test_a_static_transform_has_no_age(beside):
    transforms = module.TransformBuffer()
    static_transform = transform("map", "base_link", (0.0, 0.0, 0.0), rospy.Time(0))
    transforms.buffer.set_transform_static(static_transform, "test")
    map_to_base = transforms.latest("map", "base_link", beside.time, 1.0)
    assert map_to_base.transform.rotation.w == 1.0


def test_moving_obstacles_are_in_the_plans_frame_and_dropped_when_stale(beside):
    """The odometry frame is rotated by 90 degrees in the map, and moved by half a metre along y."""
    beside.goal("one", 5.0)
    for parent, child in (("map", "odom"), ("odom", "base_link")):
        beside.place(parent, child, (0.0, 0.5, 0.5 * np.pi), rospy.Time(0))
    movers = Movers(x=[1.0, 3.0], y=[2.0, 0.0], vx=[0.5, 0.0], vy=[0.0, -1.0], radius=[0.3, 0.3])
    beside.callbacks["applr/tracked"](stamped(movers, beside.time, "odom"))
    for plan_frame, expected_movers in (
        ("odom", [(1.0, 2.0, 0.5, 0.0), (3.0, 0.0, 0.0, -1.0)]),
        ("map", [(-2.0, 1.5, 0.0, 0.5), (0.0, 3.5, 1.0, 0.0)]),
    ):
        beside.plan(5.0, plan_frame)
        snapshot = beside.snapshot()
        np.testing.assert_allclose(snapshot.seen.movers, expected_movers, atol=1e-9)
        assert snapshot.movers_stamp == beside.time

    # After a second they are stale.
    beside.wait(1.1)
    beside.plan(5.0)
    snapshot = beside.snapshot()
    assert (snapshot.seen.movers.shape, snapshot.movers_stamp) == ((0, 4), rospy.Time())
    beside.callbacks["applr/tracked"](stamped(Movers(), beside.time, "odom"))
    assert beside.snapshot().seen.movers.shape == (0, 4)


@pytest.mark.parametrize(
    ("mounting", "first_angle", "last_range"),
    [((0.0, 0.25), -2.25, 2.0), ((math.pi, 0.25), -2.25, 1.0), ((math.pi - 0.1, 0.0), -2.5, 1.0)],
    ids=["level", "upside down", "upside down and tilted"],
)
def test_beams_are_ordered_as_seen_from_above_in_the_robots_frame(
    beside, mounting, first_angle, last_range
):
    beside.goal("one", 5.0)
    beside.plan(5.0)
    beside.mount(*mounting)
    ranges, scan_angle, increment = beside.snapshot().seen.scan
    assert scan_angle == pytest.approx(first_angle)
    assert increment == 0.01
    assert ranges[-1] == last_range


def test_a_laser_that_is_mounted_at_a_tilt_is_refused(beside):
    beside.goal("one", 5.0)
    beside.plan(5.0)
    beside.mount(0.5, 0.0)
    refused(lambda: beside.snapshot(), "is tilted", kind=ObservationError)
