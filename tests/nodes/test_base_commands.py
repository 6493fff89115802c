"""Tests of the last commands to the base before a node ends."""

import pytest
import rospy
from geometry_msgs.msg import Twist

from applr_ros1.nodes import base_commands
from applr_ros1.nodes.base_commands import LAST_ZEROS, BaseCommands
from applr_ros1.nodes.conversions import twist

pytestmark = pytest.mark.ros
ZERO = Twist()


def test_while_a_node_shuts_down_only_zeros_are_sent(monkeypatch):
    # Given: a node that commands, also while rospy calls what waits for the shutdown
    sent = []
    hooks = []
    endings = []
    monkeypatch.setattr(rospy.Publisher, "__init__", lambda *_, **__: None)
    monkeypatch.setattr(rospy.Publisher, "publish", lambda _, message: sent.append(message))
    monkeypatch.setattr(rospy, "on_shutdown", hooks.append)
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: bool(endings))
    commands = BaseCommands("cmd_vel")
    fast = twist(0.5, 0.2)
    monkeypatch.setattr(base_commands.time, "sleep", lambda _: commands.publish(fast))
    commands.publish(fast)
    assert sent == [fast]

    endings.append("interrupted")
    (end,) = hooks
    end()

    assert sent == [fast] + [ZERO] * LAST_ZEROS
