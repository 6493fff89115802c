"""Tests of the warning that costmaps mark obstacles up to another range than the method's, without
a ROS master.
"""

from types import SimpleNamespace

import pytest
import rosgraph
import rospy

from applr_ros1.nodes.applr.node import range_mismatch
from tests.support.robots import JACKAL_PARAMETERS

METHOD = SimpleNamespace(name="applr", obstacle_range=5.0)


def test_another_range_than_the_method_needs_is_said(monkeypatch):
    monkeypatch.setattr(rospy, "get_param", lambda *_: JACKAL_PARAMETERS)
    line = range_mismatch(METHOD, "/move_base")
    assert "up to 2.5 m, but method applr was made for 5 m" in line


@pytest.mark.parametrize("problem", [OSError("refused"), rosgraph.MasterException("gone")])
def test_a_missing_master_costs_no_more_than_the_warning(monkeypatch, problem):
    def get_param(*_):
        raise problem

    monkeypatch.setattr(rospy, "get_param", get_param)
    assert range_mismatch(METHOD, "/move_base") == ""


@pytest.mark.parametrize("tree", ["text", 5, [1.0], {"local_costmap": {"plugins": 3}}])
def test_parameters_that_cannot_be_read_cost_no_more_than_the_warning(monkeypatch, tree):
    monkeypatch.setattr(rospy, "get_param", lambda *_: tree)
    assert range_mismatch(METHOD, "/move_base") == ""
