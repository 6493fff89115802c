"""The viewer's tab Drive, with the method and a slider for each parameter, and the texts of the page's status.

Only the applr node sets parameters. The page uses the node's public topic and services.
"""

from __future__ import annotations

import os
import time
from typing import Any, List, Optional

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import String
from std_srvs.srv import SetBool

from applr_ros1.msg import Parameters
from applr_ros1.nodes.conversions import GOAL_STATES
from applr_ros1.policy.methods import CONTEXTS, POLICY, SET, shipped
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.srv import SetMethod

from .listening import ANSWER_S, Listener, Report, by_hand, call, publish, show

STATUS, ACTION = "move_base/status", "collision_monitor/action"
PARAMETERS, DIAGNOSTICS = "applr/parameters", "/diagnostics"
HAND = "hand"
METHODS = {
    "dwa": "default parameters",
    "static": "tuned set",
    "appld": "APPLD",
    "applr": "policy",
    HAND: HAND,
}
FILES = {
    "applr": POLICY,
    "static": SET,
    "appld": CONTEXTS,
}  # files of methods, which a robot may lack
UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING)
SILENT_S = (
    3.0  # time without a message after which a topic counts as silent, and the clock as stopped [s]
)
STANDING_M_S = 0.02  # speed below which the robot counts as at rest [m/s]


def goal_status(listener: Listener) -> Any:
    """Return the actionlib_msgs/GoalStatus of move_base's latest goal, or None if there is none."""
    message = listener.latest(STATUS, GoalStatusArray)
    goals = message.status_list if message is not None else []
    return max(goals, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


class Panel:
    """Dropdown of methods and sliders for parameters, in the current container of viser's `gui`.

    Attributes:
        space: The robot's parameters.
        sliders: Sliders by the name of the parameter.
        method: Method in the applr node's diagnostics, HAND if no method is on, "" if the node does not answer.
        trouble: Problem in the applr node's diagnostics, or "".
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, report: Report):
        self.space, self.method, self.trouble = space_of(robot), "", ""
        self._robot, self._listener, self._report = robot, listener, report
        self._status = (rospy.get_namespace() + "applr").lstrip("/") + ": parameter policy"
        self._values = rospy.Publisher("applr/set_parameters", Parameters, queue_size=10)
        self._asked = 0.0  # wall time of the last request
        there = [
            name
            for name in METHODS
            if name not in FILES or os.path.exists(shipped(FILES[name], robot))
        ]
        self._methods = {
            METHODS[name]: name for name in there
        }  # methods by their names on the page
        self._dropdown = gui.add_dropdown("parameters by", tuple(self._methods))
        by_hand(self._dropdown, lambda shown: self._choose(self._methods[shown]))
        self.sliders = {name: self._slider(gui, i) for i, name in enumerate(self.space.names)}

    def _slider(self, gui: Any, i: int) -> Any:
        """Return the slider of the i-th parameter, with unit and description from the planner's declaration."""
        space = self.space
        name, step = space.names[i], 1 if space.integer[i] else 0.01
        low, high, default = (
            type(step)(values[i]) for values in (space.low, space.high, space.theta0)
        )
        target = space.targets[name][0]
        declared = self._robot.servers[target.server].declared(target.name)
        title = f"{name} [{declared.unit}]" if declared and declared.unit else name
        look = {"marks": ((default, "default"),), "hint": declared.doc if declared else ""}
        slider = gui.add_slider(
            title, low, high, step, initial_value=min(max(default, low), high), **look
        )
        by_hand(slider, lambda value: self._take_over(**{name: float(value)}))
        return slider

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
        """Read the applr node's diagnostics, and update the dropdown and the sliders."""
        for message in self._listener.fresh(DIAGNOSTICS, DiagnosticArray):
            for status in message.status:
                if status.name == self._status and time.monotonic() - self._asked > ANSWER_S:
                    method = {pair.key: pair.value for pair in status.values}.get("method", "")
                    self.method = HAND if method == "off" else method
                    self.trouble = status.message if status.level != DiagnosticStatus.OK else ""
        if self.source in self._methods:
            show(self._dropdown, self.source)
        theta = self.theta()
        for slider, value in zip(self.sliders.values(), theta if theta is not None else ()):
            show(slider, round(min(max(float(value), slider.min), slider.max), 4))

    def _choose(self, method: str) -> None:
        """Select a method, or HAND to keep the current parameters."""
        if method == HAND:
            self._take_over()
        elif self._ask("applr/set_method", SetMethod, method) and self._ask(
            "applr/enable", SetBool, True
        ):
            self.method = method

    def _take_over(self, **values: float) -> None:
        """Switch the method off and set parameters by hand. Other parameters stay as they are."""
        self._asked, self.method = time.monotonic(), self.method and HAND
        publish(
            self._report, self._values, Parameters(names=list(values), values=list(values.values()))
        )

    def _ask(self, *request: Any) -> bool:
        done = call(self._report, *request)
        self._asked = time.monotonic()
        return done

    def doing(self, goal: Any) -> str:
        """Return the state of move_base as text. goal: GoalStatus of the latest goal, or None."""
        if self._listener.age(STATUS) > SILENT_S:
            return "move_base does not answer"
        return "waiting for a goal" if goal is None else f"goal {GOAL_STATES[goal.status]}"

    def monitor(self) -> str:
        """Return the action of the collision monitor as text."""
        action = self._listener.latest(ACTION, String)
        return "no collision monitor" if action is None else f"monitor: {action.data}"

    def silence(self) -> List[str]:
        """Return a line for each node or topic that is silent."""
        age, robot, lines = self._listener.age, self._robot, []
        if age(STATUS) > SILENT_S:
            lines.append(f"no move_base: nothing on {rospy.resolve_name(STATUS)}")
        elif self.trouble:
            lines.append(self.trouble)
        for what, topic in (("scan", robot.topics.scan), ("odometry", robot.topics.odometry)):
            if age(topic) > SILENT_S:
                lines.append(f"no {what}: nothing on {rospy.resolve_name(topic)}")
        if not self.method:
            lines.append("no applr node: parameters cannot be set")
        return lines
