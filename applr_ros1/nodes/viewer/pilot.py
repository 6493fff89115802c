"""Who sets the planner's parameters: a method of the applr node, or a person by hand.

Uses the applr node's services and move_base's dynamic_reconfigure servers, as any other client could.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any, Optional

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import SetBool

from applr_ros1.msg import Parameters
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.srv import SetMethod

from .listening import ANSWER, Listener, Say, call

HAND = "hand"
METHODS = {"dwa": "default parameters", "static": "best single set", "appld": "APPLD", "applr": "policy", HAND: HAND}
PARAMETERS, DIAGNOSTICS = "applr/parameters", "/diagnostics"
SETTLED = 2.0  # wall seconds after which the applr node, switched off, sends its default parameters no more


class Pilot:
    """Reads and sets a robot's parameters; all methods may be called from any thread.

    Attributes:
        method: Of the applr node by its diagnostics, HAND where it is switched off, "" where it does not answer.
        trouble: One line about what does not answer; "" where nothing is wrong.
    """

    def __init__(self, robot: Robot, listener: Listener, say: Say):
        self.space, self.method, self.trouble = space_of(robot), "", ""
        self._listener, self._say = listener, say
        self._status = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self.client = ReconfigureClient(
            rospy.resolve_name("move_base"),
            self.space,
            on_report=lambda report: self._note(report.error),
            on_trouble=self._note,
        )
        self.client.start()
        self._hand: Optional[np.ndarray] = None  # what a person wants, for SETTLED after it was set
        self._asked = 0.0  # wall time of the last call to the applr node; inf while one waits for its answer
        self._lock = threading.Lock()

    def _note(self, trouble: str) -> None:
        self.trouble = trouble

    @property
    def who(self) -> str:
        """Who sets the parameters, as the page calls it."""
        return METHODS.get(self.method, self.method) or "nobody"

    def theta(self) -> Optional[np.ndarray]:
        """The parameters (n,) in force or on their way; None without move_base's servers."""
        message = self._listener.newest(PARAMETERS, Parameters)
        if message is not None and tuple(message.names) == self.space.names:
            self.client.compensation.multipliers = np.array(message.multipliers, np.float64)
        if not self.client.connected:
            return None
        return self.client.theta() if self._hand is None else self._hand

    def look(self) -> None:
        """Take in the applr node's diagnostics, and set again what its last request has undone of a person's values."""
        since = time.monotonic() - self._asked
        for message in self._listener.fresh(DIAGNOSTICS, DiagnosticArray):
            for status in message.status:
                if status.name == self._status and since > ANSWER:
                    method = {pair.key: pair.value for pair in status.values}.get("method", "")
                    self.method = HAND if method == "off" else method
        with self._lock:
            theta = self.client.theta()
            if self._hand is not None and theta is not None and not self.client.busy:
                if not np.array_equal(theta, self._hand):
                    self.client.request(self._hand)
                elif since > SETTLED:
                    self._hand = None

    def choose(self, method: str) -> bool:
        """Have the applr node set the parameters by a method, or keep them (HAND). Returns whether it does."""
        if method == HAND:
            return self.take_over()
        with self._lock:
            self._hand = None
        done = self._ask("applr/set_method", SetMethod, method) and self._ask("applr/enable", SetBool, True)
        self.method = method if done else self.method
        return done

    def take_over(self, name: str = "", value: float = 0.0) -> bool:
        """Switch the applr node off and set one parameter by hand, or none. Returns whether that was done."""
        theta = self.theta()
        if theta is None or not self.client.connected:
            self._say("no move_base: its parameters cannot be set")
            return False
        with self._lock:
            self._asked = math.inf
            self._hand = self.space.clip(np.where(np.array(self.space.names) == name, value, theta))
        if self.method not in (HAND, "") and not self._ask("applr/enable", SetBool, False):
            self._hand = None
            return False
        self._asked, self.method = time.monotonic(), self.method and HAND
        return True

    def _ask(self, *request: Any) -> bool:
        done = call(self._say, *request)
        self._asked = time.monotonic()
        return done

    def close(self) -> None:
        """End the thread that sets parameters."""
        self.client.close()
