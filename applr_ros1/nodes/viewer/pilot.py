"""Selection of the source of the planner's parameters: a method of the applr node, or the user's sliders.

Only the applr node sets parameters. The page uses its public topic and services.
"""

from __future__ import annotations

import time
from typing import Any, Optional

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import SetBool

from applr_ros1.msg import Parameters
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.srv import SetMethod

from .listening import ANSWER_S, Listener, Report, call, publish

HAND = "hand"
METHODS = {"dwa": "default parameters", "static": "best single set", "appld": "APPLD", "applr": "policy", HAND: HAND}
PARAMETERS, DIAGNOSTICS = "applr/parameters", "/diagnostics"


class MethodSelector:
    """Client of the applr node. All methods may be called from any thread.

    Attributes:
        space: The robot's parameters.
        method: Method in the applr node's diagnostics, HAND if it is switched off, "" if the node does not answer.
        trouble: Problem in the applr node's diagnostics, or "".
    """

    def __init__(self, robot: Robot, listener: Listener, report: Report):
        self.space, self.method, self.trouble = space_of(robot), "", ""
        self._listener, self._report = listener, report
        self._status = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._values = rospy.Publisher("applr/set_parameters", Parameters, queue_size=10)
        self._asked = 0.0  # wall time of the last request

    @property
    def source(self) -> str:
        """Name of the source of the parameters, for the page."""
        return METHODS.get(self.method, self.method) or "nobody"

    def theta(self) -> Optional[np.ndarray]:
        """Return the planner's parameters (n,), or None before the applr node has read them."""
        message = self._listener.latest(PARAMETERS, Parameters)
        known = message is not None and tuple(message.names) == self.space.names
        return np.array(message.values, np.float64) if known else None

    def update(self) -> None:
        """Read the applr node's diagnostics."""
        for message in self._listener.fresh(DIAGNOSTICS, DiagnosticArray):
            for status in message.status:
                if status.name == self._status and time.monotonic() - self._asked > ANSWER_S:
                    method = {pair.key: pair.value for pair in status.values}.get("method", "")
                    self.method = HAND if method == "off" else method
                    self.trouble = status.message if status.level != DiagnosticStatus.OK else ""

    def choose(self, method: str) -> None:
        """Select a method, or HAND to keep the parameters in force."""
        if method == HAND:
            self.take_over()
        elif self._ask("applr/set_method", SetMethod, method) and self._ask("applr/enable", SetBool, True):
            self.method = method

    def take_over(self, **values: float) -> None:
        """Switch the method off and set parameters by hand. Other parameters stay as they are."""
        self._asked, self.method = time.monotonic(), self.method and HAND
        publish(self._report, self._values, Parameters(names=list(values), values=list(values.values())))

    def _ask(self, *request: Any) -> bool:
        done = call(self._report, *request)
        self._asked = time.monotonic()
        return done
