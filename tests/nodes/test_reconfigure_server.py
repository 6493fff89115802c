"""Test of the dynamic_reconfigure servers of move_base, without a ROS master."""

import threading
from types import SimpleNamespace

import pytest
import rospy
from dynamic_reconfigure.msg import Config, DoubleParameter, StrParameter

from applr_ros1.nodes.move_base.reconfigure_server import ReconfigureServer
from applr_ros1.planner.move_base import MoveBase
from tests.support.robots import JACKAL_PARAMETERS

pytest_plugins = ("tests.support.offline_ros",)


@pytest.fixture
def set_parameters(offline_ros):
    """Provide set_parameters(config), the service callback of the Jackal's local planner."""
    move_base = MoveBase(JACKAL_PARAMETERS)
    ReconfigureServer("TrajectoryPlannerROS", move_base, threading.RLock())
    (callback,) = offline_ros.callbacks.values()
    return lambda config: callback(SimpleNamespace(config=config))


def value_of(config, name):
    """Return a number of a dynamic_reconfigure/Config."""
    return {double.name: double.value for double in config.doubles}[name]


def test_a_text_in_place_of_a_number_is_refused_in_one_line(set_parameters):
    before = set_parameters(Config(doubles=[DoubleParameter("max_vel_x", 0.7)]))
    with pytest.raises(rospy.ServiceException, match="max_vel_x is 'fast': give a finite number"):
        set_parameters(Config(strs=[StrParameter("max_vel_x", "fast")]))
    assert set_parameters(Config()) == before
    assert value_of(before, "max_vel_x") == 0.7
