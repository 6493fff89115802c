"""Tests of invalid goals, and of dangerous commands from a planner."""

import math
import threading
import time

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import Twist

from applr_ros1.nodes.conversions import twist
from applr_ros1.robots import load
from tests.support.nodes import ABORTED, finish, goal
from tests.support.ros import wait_for

pytestmark = pytest.mark.ros


@pytest.mark.fault("15")
@pytest.mark.parametrize(
    ("invalid", "problem"),
    [
        (dict(x=1.0, quaternion=(0.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(1.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(0.0, 0.0, math.nan, 1.0)), "invalid quaternion"),
        (dict(x=math.nan), "not finite"),
        (dict(x=1.0, frame="nowhere"), "'nowhere' cannot be transformed"),
        (dict(x=1.0, frame=""), "frame_id"),
    ],
)
def test_invalid_goals_are_aborted_with_the_reason(stack, measured, invalid, problem):
    stack.cancel_goal()
    began = time.monotonic()
    stack.client.send_goal(goal(**invalid))
    finished = finish(stack.client)
    measured("aborted after", time.monotonic() - began, "s")
    assert finished.state == ABORTED
    assert problem in finished.text
    assert "\n" not in finished.text


@pytest.fixture
def mad(stack):
    """Provide mad(v), which replaces move_base's commands by v [m/s] straight down the alley."""
    # Straight: a robot that turns on the spot also slides, at up to 0.09 m/s.
    stack.back_to_the_start()
    publisher = rospy.Publisher("/move_base/cmd_vel", Twist, queue_size=1)
    commanded = {"v": 0.0}
    test_is_over = threading.Event()
    wait_for(publisher.get_num_connections, "connection")

    def publish():
        # At 25 Hz, a little more often than move_base would
        while not test_is_over.wait(0.04):
            # Steer back to the straight line: a little to one side, the robot would hit the posts
            # beside the alley instead of its end.
            y, yaw = stack.relay.aside
            v = commanded["v"]
            steering_gain = max(1.0, abs(v) / 2.0)
            publisher.publish(twist(v, -(y + 2.0 * yaw) * steering_gain))

    publishing_thread = threading.Thread(target=publish)
    publishing_thread.start()

    def command(v):
        commanded["v"] = v

    yield command
    test_is_over.set()
    publishing_thread.join()
    publisher.unregister()


@pytest.mark.fault("14b")
def test_a_faulty_planner_is_stopped_before_the_wall(stack, mad, measured):
    """Commands are NaN, infinite, and then full speed towards a wall: the robot stops before the
    wall.
    """
    stack.until(lambda: abs(stack.relay.speed) < 0.01, "standstill")
    for v in (math.nan, math.inf, -math.inf):
        mad(v)
        time.sleep(0.15)
        assert stack.relay.speed == pytest.approx(0.0, abs=0.01)

    # First as fast as the robot is, so that it drives when the absurd command comes.
    mad(2.0)
    stack.until(lambda: stack.relay.speed > 1.8, "speed")
    mad(1e9)
    # Where the robot's front touches the posts at the end of the alley [m]
    contact_x = 19.0 - 0.1 - 0.229
    stack.until(
        lambda: stack.relay.x > contact_x - 0.3 and stack.relay.speed < 0.01,
        "standstill at the wall",
    )
    measured("stands before the wall by", contact_x - stack.relay.x, "m")
    # The promise holds for commands that reach the base within the reaction time.
    longest_delay = np.diff([command.stamp for command in stack.relay.commands[-75:]]).max()
    if longest_delay > load("jackal").monitor.reaction_time:
        stack.relay.touched = None
        pytest.skip(
            f"the machine is too busy: a command reached the base after {longest_delay:.2f} s"
        )
    # At the end of braking 1 of 128 approaches touches the wall, at 0.07 m/s
    # (docs/explanation/collision_monitor.md, "Measured").
    touched = stack.relay.touched
    assert touched is None or abs(touched.speed) < 0.1
    assert stack.relay.x < contact_x
    # There, it could also touch the wall as it settles.
    mad(0.0)
    stack.back_to_the_start()
