"""The choice of who sets the planner's parameters: a method of the applr node, or a person by hand.

The applr node alone sets parameters; the page asks it by the topic and the services that it offers to everybody.
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

from .listening import ANSWER_S, Listener, Say, call, publish

HAND = "hand"
METHODS = {"dwa": "default parameters", "static": "best single set", "appld": "APPLD", "applr": "policy", HAND: HAND}
PARAMETERS, DIAGNOSTICS = "applr/parameters", "/diagnostics"


class MethodSelector:
    """The page's side of the applr node; all methods may be called from any thread.

    Attributes:
        space: The robot's parameters.
        method: Of the applr node by its diagnostics, HAND where it is switched off, "" where it does not answer.
        trouble: One line of its diagnostics about what is wrong; "" where nothing is.
    """

    def __init__(self, robot: Robot, listener: Listener, say: Say):
        self.space, self.method, self.trouble = space_of(robot), "", ""
        self._listener, self._say = listener, say
        self._status = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._values = rospy.Publisher("applr/set_parameters", Parameters, queue_size=10)
        self._asked = 0.0  # wall time of the last request

    @property
    def who(self) -> str:
        """The page's name of what sets the parameters."""
        return METHODS.get(self.method, self.method) or "nobody"

    def theta(self) -> Optional[np.ndarray]:
        """The parameters (n,) that the planner has; None before the applr node has read them."""
        message = self._listener.newest(PARAMETERS, Parameters)
        known = message is not None and tuple(message.names) == self.space.names
        return np.array(message.values, np.float64) if known else None

    def look(self) -> None:
        """Take in the applr node's diagnostics."""
        for message in self._listener.fresh(DIAGNOSTICS, DiagnosticArray):
            for status in message.status:
                if status.name == self._status and time.monotonic() - self._asked > ANSWER_S:
                    method = {pair.key: pair.value for pair in status.values}.get("method", "")
                    self.method = HAND if method == "off" else method
                    self.trouble = status.message if status.level != DiagnosticStatus.OK else ""

    def choose(self, method: str) -> None:
        """Have the parameters set by a method, or keep those in force (HAND)."""
        if method == HAND:
            self.take_over()
        elif self._ask("applr/set_method", SetMethod, method) and self._ask("applr/enable", SetBool, True):
            self.method = method

    def take_over(self, **values: float) -> None:
        """Switch the method off, and set parameters by hand; the others stay as they are."""
        self._asked, self.method = time.monotonic(), self.method and HAND
        publish(self._say, self._values, Parameters(names=list(values), values=list(values.values())))

    def _ask(self, *request: Any) -> bool:
        done = call(self._say, *request)
        self._asked = time.monotonic()
        return done
