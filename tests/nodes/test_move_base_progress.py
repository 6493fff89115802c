"""Tests of what the collision monitor knows of move_base's goal and plan, without a ROS master."""

import pytest
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from nav_msgs.msg import Path

from applr_ros1.nodes.conversions import pose_stamped
from applr_ros1.nodes.monitor.move_base_progress import MoveBaseProgress

pytest_plugins = ("tests.support.offline_ros",)


@pytest.mark.parametrize(
    ("status", "age_s", "goal"),
    [
        (GoalStatus.ACTIVE, 0.9, "a"),
        (GoalStatus.ACTIVE, 1.1, None),  # move_base is gone.
        (GoalStatus.PREEMPTING, 0.0, None),
        (GoalStatus.SUCCEEDED, 0.0, None),
    ],
)
def test_a_goal_counts_while_its_status_is_active_and_repeated(offline_ros, status, age_s, goal):
    move_base = MoveBaseProgress()
    # As actionlib does, move_base lists an ended goal for a while.
    listed = [
        GoalStatus(GoalID(id="earlier"), GoalStatus.SUCCEEDED, ""),
        GoalStatus(GoalID(id="a"), status, ""),
    ]
    offline_ros.callbacks["move_base/status"](GoalStatusArray(status_list=listed))
    offline_ros.now += age_s
    assert move_base.progress(offline_ros.time).goal == goal


def test_the_distance_is_that_of_the_ends_of_a_plan_and_unknown_without_one(offline_ros):
    move_base = MoveBaseProgress()
    take_plan = offline_ros.callbacks["move_base/NavfnROS/plan"]
    for points, distance in (([(1.0, 2.0), (0.0, 9.0), (1.0, 7.0)], 5.0), ([], None)):
        poses = [pose_stamped((x, y, 0.0), "odom", offline_ros.time) for x, y in points]
        take_plan(Path(poses=poses))
        assert move_base.progress(offline_ros.time).distance == distance
