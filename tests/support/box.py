"""The black box beside a stack, as tests and benchmarks see it."""

import sys
import time

import rospy
from applr_ros1.msg import Stop
from diagnostic_msgs.msg import DiagnosticArray
from visualization_msgs.msg import Marker

from tests.support.nodes import values_of


class Box:
    """The black box with what it publishes.

    Args:
        node: Its process (Child), which has just been started.
        folder: Folder of its bags (Path).

    Attributes:
        answers: (wall time [s] at which it came, applr_ros1/Stop) of each answer.
    """

    def __init__(self, node, folder):
        self.node = node
        self.folder = folder
        self.answers = []
        self.markers = []
        self.diagnostics = {}
        rospy.Subscriber("/black_box/answer", Stop, self._on_answer)
        rospy.Subscriber("/black_box/marker", Marker, self.markers.append)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)

    def _on_answer(self, message):
        self.answers.append((time.time(), message))

    def _on_diagnostics(self, message):
        status = message.status[0]
        if status.name == "black_box: stops":
            self.diagnostics = values_of(status)

    @property
    def bags(self):
        """Paths of the written bags."""
        return sorted(self.folder.glob("stop_*.bag"))


def spawned(master, folder):
    """Start the black box with a RosMaster as a user starts it, and return its Child."""
    return master.spawn(
        sys.executable, "-m", "applr_ros1.nodes.black_box.node", f"_folder:={folder}"
    )
