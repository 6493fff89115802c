"""Commands to the base, the last of which are zeros."""

from __future__ import annotations

import time

import rospy
from geometry_msgs.msg import Twist as TwistMessage

ZEROS_S = 0.05  # time between two zeros [s]
LAST_ZEROS = 10  # number of zeros before a process ends


class BaseCommands(rospy.Publisher):  # type: ignore[misc]  # rospy has no types
    """Publisher of commands to the base that stops it when the node shuts down.

    A base without a time-out of its own keeps driving with the last command. Topics are still open
    while rospy calls what waits for the shutdown, and so are callbacks and loops that command: from
    then on only zeros are sent.

    Args:
        topic: Name of the topic.
        latch: Whether a later subscriber gets the last command.
    """

    def __init__(self, topic: str, latch: bool = False):
        super().__init__(topic, TwistMessage, queue_size=1, latch=latch)
        rospy.on_shutdown(self._end)

    def publish(self, command: TwistMessage) -> None:
        """Publish a command, unless the node shuts down."""
        if not rospy.core.is_shutdown_requested():
            super().publish(command)

    def _end(self) -> None:
        publish_zeros(super())


def publish_zeros(commands: rospy.Publisher) -> None:
    """Publish the last zeros before a process ends.

    A single zero might be lost because exiting closes connections, and a command that is just
    being published may follow it.
    """
    for _ in range(LAST_ZEROS):
        commands.publish(TwistMessage())
        time.sleep(ZEROS_S)
