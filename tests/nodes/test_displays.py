"""Tests of the messages for displays: their frames, and the rate of the trajectories."""

from types import SimpleNamespace
from unittest.mock import create_autospec

import numpy as np
import pytest
import rospy

from applr_ros1.nodes.conversions import COST_FIELDS
from applr_ros1.nodes.move_base import displays
from applr_ros1.planner.local_planner import LocalPlanner

pytestmark = pytest.mark.ros
pytest_plugins = ("tests.support.offline_ros",)
PATH = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])


def shown(planner_name, parameters):
    """Return a PlanDisplay of a move_base whose local costmap is in the frame `matched`."""
    all_parameters = {
        planner_name: {"publish_cost_grid_pc": True, **parameters},
        "global_costmap": {"global_frame": "/map"},
        "local_costmap": {"global_frame": "matched"},
    }
    move_base = SimpleNamespace(local_planner_name=planner_name, parameters=all_parameters)
    return displays.PlanDisplay(move_base)


def local_planner():
    """Return a stand-in for a local planner that has a plan, a path, and one sample."""
    planner = create_autospec(LocalPlanner, instance=True, cropped_plan=PATH, local_plan=PATH)
    planner.cost_cloud.return_value = np.zeros((1, len(COST_FIELDS)))
    planner.trajectory_cloud.return_value = np.zeros((1, len(displays.TRAJECTORY_FIELDS)))
    return planner


def test_each_message_has_the_frame_of_its_points(offline_ros):
    display = shown("DWAPlannerROS", {"publish_traj_pc": True, "global_frame_id": "odom"})
    display.planned(PATH, rospy.Time(1))
    display.controlled(local_planner(), None, rospy.Time(1))
    frames = {}
    fields = {}
    for topic, messages in offline_ros.published.items():
        (message,) = messages
        name = topic.rpartition("/")[2]
        frames[name] = message.header.frame_id
        fields[name] = [field.name for field in getattr(message, "fields", ())]
    assert frames == {
        "plan": "map",
        "global_plan": "matched",
        "local_plan": "matched",
        "cost_cloud": "matched",
        "trajectory_cloud": "matched",
    }
    assert fields["trajectory_cloud"] == ["x", "y", "z", "theta", "cost"]


@pytest.mark.parametrize(
    ("planner_name", "parameters", "count"),
    [
        ("DWAPlannerROS", {"publish_traj_pc": True}, 11),
        ("DWAPlannerROS", {"publish_traj_pc": False}, 0),
        # In C++ it has no such cloud: it comes at 5 Hz.
        ("TrajectoryPlannerROS", {}, 6),
    ],
)
def test_trajectories_come_in_each_cycle_as_in_cpp_or_five_times_a_second(
    planner_name, parameters, count, offline_ros
):
    display = shown(planner_name, parameters)
    for cycle in range(11):
        stamp = rospy.Time.from_sec(5.0 + 0.1 * cycle)
        display.controlled(local_planner(), None, stamp)
    assert len(offline_ros.published[f"~{planner_name}/trajectory_cloud"]) == count
