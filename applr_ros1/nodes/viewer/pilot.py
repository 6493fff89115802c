"""Who sets the planner's parameters: a method of the applr node, or a person by hand.

Uses the applr node's services and move_base's dynamic_reconfigure servers, as any other client could.
"""

from __future__ import annotations

import threading
import time
from typing import Optional

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import SetBool

from applr_ros1.common.errors import reason
from applr_ros1.msg import Parameters
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.nodes.applr.reconfigure_worker import ReconfigureWorker
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.srv import SetMethod

from .listening import Listener

HAND = "by hand"
PARAMETERS, DIAGNOSTICS = "applr/parameters", "/diagnostics"
TOPICS = {PARAMETERS: Parameters, DIAGNOSTICS: DiagnosticArray}
SETTLED = 2.0  # wall seconds after which the applr node, switched off, sends its default parameters no more
ANSWER = 1.0  # wall seconds that a service has to appear


class Pilot:
    """Reads and sets parameters; all methods may be called from any thread.

    Args:
        robot: Whose parameters.
        listener: Has TOPICS.

    Attributes:
        method: Of the applr node as it last said, HAND where it is switched off, "" where it does not answer.
        trouble: One line about what does not answer; "" where nothing is wrong.
    """

    def __init__(self, robot: Robot, listener: Listener):
        self.space, self.method, self.trouble = space_of(robot), "", ""
        self._listener = listener
        self._status = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self.client = ReconfigureClient(rospy.resolve_name("move_base"), self.space)
        self._worker = ReconfigureWorker(self.client, self._on_report, self._on_trouble)
        self._worker.start()
        self._hand: Optional[np.ndarray] = None  # what a person wants, for SETTLED after it was set
        self._set, self._asked = 0.0, 0.0  # wall times of the last change by hand and of the last call to applr
        self._lock = threading.Lock()

    def theta(self) -> Optional[np.ndarray]:
        """The parameters (n,) in force; those that the applr node tells where move_base has no servers (a bag)."""
        told = self._listener.newest(PARAMETERS)
        names = told is not None and tuple(told.names) == self.space.names
        if names and len(told.multipliers) == len(self.space):
            self.client.compensation.multipliers = np.array(told.multipliers, np.float64)
        if self.client.connected:
            return self.client.theta()
        return np.array(told.values, np.float64) if names else None

    def look(self) -> None:
        """Take in what the applr node says, and hold what a person has set against its last words."""
        for message in self._listener.fresh(DIAGNOSTICS):
            for status in message.status:
                if status.name == self._status and time.monotonic() - self._asked > ANSWER:
                    said = {pair.key: pair.value for pair in status.values}.get("method", "")
                    self.method = HAND if said == "off" else said
        with self._lock:
            held, theta = self._hand, self.client.theta()
            if held is not None and not self._worker.busy and theta is not None:
                if not np.array_equal(theta, held):
                    self._worker.request(held)
                elif time.monotonic() - self._set > SETTLED:
                    self._hand = None

    def take_over(self, name: str, value: float) -> str:
        """Set one parameter by hand, with the applr node switched off. Returns "" or one line why not."""
        theta = self._hand if self._hand is not None else self.theta()
        if theta is None or not self.client.connected:
            return "no move_base: its parameters cannot be set"
        theta = self.space.clip(np.where(np.array(self.space.names) == name, value, theta))
        problem = "" if self.method in (HAND, "") else self._call("applr/enable", SetBool, False)
        if problem:
            return problem
        with self._lock:
            self.method, self._hand, self._set = HAND if self.method else "", theta, time.monotonic()
            self._worker.request(theta)
        return ""

    def hand_to(self, method: str) -> str:
        """Have the applr node set the parameters by a method. Returns "" or one line why not."""
        with self._lock:
            self._hand = None
        problem = self._call("applr/set_method", SetMethod, method) or self._call("applr/enable", SetBool, True)
        if not problem:
            self.method = method
        return problem

    def hold(self) -> str:
        """Switch the applr node off and keep the parameters as they are. Returns "" or one line why not."""
        theta = self.theta()
        if theta is None:
            return "no move_base: its parameters are not known"
        return self.take_over(self.space.names[0], float(theta[0]))

    def close(self) -> None:
        """End the thread that sets parameters."""
        self._worker.stop()
        self.client.close()

    def _call(self, name: str, kind: type, request: object) -> str:
        self._asked = time.monotonic()
        try:
            rospy.wait_for_service(name, ANSWER)
            answer = rospy.ServiceProxy(name, kind)(request)
        except rospy.ROSException:
            return "no applr node: %s does not answer" % rospy.resolve_name(name)
        except rospy.ServiceException as error:
            return "%s: %s" % (rospy.resolve_name(name), reason(error))
        self._asked = time.monotonic()
        return "" if answer.success else answer.message

    def _on_report(self, report) -> None:
        self.trouble = report.error

    def _on_trouble(self, text: str) -> None:
        self.trouble = text
