"""Goals and services that nobody should send, or not so often; and commands that no planner should give."""

import math
import threading
import time

import pytest
import rospy
from geometry_msgs.msg import Twist
from move_base_msgs.msg import MoveBaseActionGoal, MoveBaseActionResult
from nav_msgs.srv import GetPlan
from std_srvs.srv import Empty

from applr_ros1.nodes.conversions import twist
from tests.support.move_base_stack import ABORTED, PREEMPTED, SUCCEEDED, collect, finish, goal
from tests.support.ros_harness import LONGEST, Kept, wait_for

pytestmark = pytest.mark.ros
RECALLED = 8


@pytest.mark.fault("15")
def test_a_hundred_goals_in_a_second(stack, measured):
    stack.back_to_the_start()
    publisher = rospy.Publisher("/move_base/goal", MoveBaseActionGoal, queue_size=200)
    subscriber, got = collect("/move_base/result", MoveBaseActionResult)
    wait_for(publisher.get_num_connections, "the connection")
    del stack.relay.planned[:-1]
    kept = Kept()
    for i in range(100):
        message = MoveBaseActionGoal(goal=goal(0.3 + 0.003 * i))
        message.goal_id.id, message.goal_id.stamp = "goal %d" % i, rospy.Time.now()
        publisher.publish(message)
        time.sleep(0.01)
    wait_for(lambda: len(got) == 100, "results")
    ends = {r.status.goal_id.id: r.status.status for r in got}
    assert len(ends) == 100
    assert ends["goal 99"] == SUCCEEDED
    assert set(ends.values()) <= {PREEMPTED, SUCCEEDED, RECALLED}
    gap = stack.longest_gap()
    measured("longest gap of commands", 1e3 * gap, "ms")
    assert gap < 0.3 + kept.waiting()  # all of which may fall into one gap
    subscriber.unregister()
    publisher.unregister()


@pytest.mark.fault("15")
@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (dict(x=1.0, quaternion=(0.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(1.0, 0.0, 0.0, 0.0)), "invalid quaternion"),
        (dict(x=1.0, quaternion=(0.0, 0.0, math.nan, 1.0)), "invalid quaternion"),
        (dict(x=math.nan), "not finite"),
        (dict(x=1.0, frame="nowhere"), "'nowhere' cannot be transformed"),
        (dict(x=1.0, frame=""), "frame_id"),
    ],
)
def test_goals_that_cannot_be(stack, measured, bad, words):
    stack.give_up()
    began = time.monotonic()
    stack.client.send_goal(goal(**bad))
    state, text = finish(stack.client)
    measured("aborted after", time.monotonic() - began, "s")
    assert state == ABORTED
    assert words in text
    assert "\n" not in text


@pytest.mark.fault("16")
def test_make_plan_and_clear_costmaps_all_the_time(stack, measured):
    """Calls that held up the control would do so in each of three windows; a machine that is busy now and then does not
    in all of them.
    """
    gaps = []
    for _ in range(3):
        stack.under_way(room=12.0)
        kept = Kept()
        gap = _longest_gap_under_calls(stack, 2.0)
        gaps.append(gap / kept.slowdown())
        if gaps[-1] < 0.25:
            break
    measured("longest gap of commands", 1e3 * gap, "ms")
    assert min(gaps) < 0.25, gaps
    stack.drives_again()


def _longest_gap_under_calls(stack, seconds):
    """The longest time between two commands [s] while two threads call the services for so long; all answers right."""
    del stack.relay.planned[:-1]
    calls, wrong, over = [0, 0], [], time.monotonic() + seconds

    def hammer(i, name, kind, *arguments):
        proxy = rospy.ServiceProxy(name, kind, persistent=True)
        while time.monotonic() < over or calls[i] <= 10:
            answer = proxy(*arguments)
            calls[i] += 1
            if i == 0 and (len(answer.plan.poses) < 20 or answer.plan.poses[-1].pose.position.x != 2.0):
                wrong.append(answer)

    threads = [
        threading.Thread(target=hammer, args=a)
        for a in (
            (0, "/move_base/NavfnROS/make_plan", GetPlan, goal(0.0).target_pose, goal(2.0).target_pose, 0.0),
            (1, "/move_base/clear_costmaps", Empty),
        )
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONGEST)
    assert not any(thread.is_alive() for thread in threads)
    assert not wrong
    return stack.longest_gap()


@pytest.fixture
def mad(stack):
    """mad(v): from now on something else commands, in place of move_base: v [m/s], straight on down the alley."""
    stack.give_up()
    if stack.relay.x > 9.0:
        stack.back_to_the_start()
    publisher, command, over = rospy.Publisher("/move_base/cmd_vel", Twist, queue_size=1), [0.0], threading.Event()
    wait_for(publisher.get_num_connections, "connection")

    def publish():
        while not over.wait(0.04):
            y, yaw = stack.relay.aside
            publisher.publish(twist(command[0], -(y + 2.0 * yaw) * max(1.0, abs(command[0]) / 2.0)))

    thread = threading.Thread(target=publish)
    thread.start()
    yield lambda v: command.__setitem__(0, v)
    over.set()
    thread.join()
    publisher.unregister()


@pytest.mark.fault("11b")
def test_a_frozen_image_at_full_speed(stack, mad, measured):
    """The scanner sends the same image under new stamps while the robot drives at 2 m/s towards a wall."""
    mad(2.0)
    stack.until(lambda: stack.relay.speed > 1.9, "speed")
    image = []

    def freeze(scan):
        image.append(scan.ranges)
        scan.ranges = image[0]
        return scan

    took = stack.stands_after(lambda: stack.relay.bend.__setitem__("scan", freeze))
    assert any("frozen" in action for action in stack.actions)
    measured("stands after", took, "s")


@pytest.mark.fault("14b")
def test_a_planner_gone_mad(stack, mad, measured):
    """Full speed at a wall, and numbers that are none: the robot stands before the wall."""
    stack.until(lambda: abs(stack.relay.speed) < 0.01, "standstill")
    for v in (math.nan, math.inf, -math.inf):
        mad(v)
        time.sleep(0.15)
        assert stack.relay.speed == pytest.approx(0.0, abs=0.01)
    mad(2.0)
    stack.until(lambda: stack.relay.speed > 1.8, "speed")
    mad(1e9)
    wall = 19.0 - 0.1 - 0.229
    stack.until(lambda: stack.relay.x > wall - 0.3 and stack.relay.speed < 0.01, "standstill at the wall")
    measured("stands before the wall by", wall - stack.relay.x, "m")
    assert stack.relay.x < wall
