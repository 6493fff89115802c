"""The viewer's tab Drive: the method, a slider for each parameter, and the status in words.

Only the applr node sets parameters. The page uses the node's public topic and services.
"""

from __future__ import annotations

import os
import time
from typing import Any, List, Optional

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import String
from std_srvs.srv import SetBool

from applr_ros1.common.arrays import Array
from applr_ros1.common.ros_node import policy_status
from applr_ros1.msg import Parameters
from applr_ros1.nodes.conversions import GOAL_STATES
from applr_ros1.policy.methods import CONTEXTS, POLICY, SET, shipped
from applr_ros1.policy.parameter_space import declaration, space_of
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import SILENT_ON_PAGE_S
from applr_ros1.srv import SetMethod

from .listening import ANSWER_S, Listener, Report, by_hand, call, publish, show

STATUS = "move_base/status"
ACTION = "collision_monitor/action"
PARAMETERS = "applr/parameters"
DIAGNOSTICS = "/diagnostics"
HAND = "hand"  # method of the page for parameters that the user sets
METHODS = {
    "dwa": "default parameters",
    "static": "tuned set",
    "appld": "APPLD",
    "applr": "policy",
    HAND: HAND,
}
# Files of methods, which a robot may lack
FILES = {"applr": POLICY, "static": SET, "appld": CONTEXTS}


def goal_status(listener: Listener) -> Any:
    """Return the actionlib_msgs/GoalStatus of move_base's latest goal, or None if there is none."""
    message = listener.latest(STATUS, GoalStatusArray)
    goal_statuses = message.status_list if message is not None else []
    return max(goal_statuses, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


class Panel:
    """Dropdown of methods and sliders for parameters, in the current container of viser's `gui`.

    Attributes:
        space: The robot's parameters.
        sliders: Sliders by the name of the parameter.
        method: Method in the applr node's diagnostics, HAND if no method is on, "" if the node
            does not answer.
        trouble: Problem in the applr node's diagnostics, or "".
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, report: Report):
        self.space = space_of(robot)
        self.method = ""
        self.trouble = ""
        self._robot = robot
        self._listener = listener
        self.report = report
        self._status = policy_status()
        self._values = rospy.Publisher("applr/set_parameters", Parameters, queue_size=10)
        self._asked = 0.0  # wall time of the last request
        self._methods = {}  # methods by their names on the page
        for method_name, title in METHODS.items():
            if method_name not in FILES or os.path.exists(shipped(FILES[method_name], robot)):
                self._methods[title] = method_name
        self.dropdown = gui.add_dropdown("parameters by", tuple(self._methods))
        by_hand(self.dropdown, lambda title: self._choose(self._methods[title]))
        self.sliders = {}
        for i, parameter_name in enumerate(self.space.names):
            self.sliders[parameter_name] = self._slider(gui, i)

    def _slider(self, gui: Any, i: int) -> Any:
        """Return the slider of the i-th parameter.

        Unit and description come from the planner's declaration.
        """
        space = self.space
        parameter_name = space.names[i]
        declared = declaration(self._robot, parameter_name)
        title = f"{parameter_name} [{declared.unit}]" if declared.unit else parameter_name
        # The page moves a number that is typed into this range.
        title += f"\n{space.low[i]:g} to {space.high[i]:g}"

        # viser shows decimals unless all numbers of a slider are integers.
        is_integer = space.integer[i]
        number_type = int if is_integer else float
        lowest = number_type(space.low[i])
        highest = number_type(space.high[i])
        default = number_type(space.theta0[i])
        slider = gui.add_slider(
            title,
            lowest,
            highest,
            1 if is_integer else 0.01,
            initial_value=min(max(default, lowest), highest),
            marks=((default, "default"),),
            hint=declared.doc,
        )
        by_hand(slider, lambda value: self._take_over(**{parameter_name: float(value)}))
        return slider

    @property
    def source(self) -> str:
        """Name of the source of the parameters, for the page."""
        return METHODS.get(self.method, self.method) or "nobody"

    def theta(self) -> Optional[Array]:
        """Return the planner's parameters (n,), or None before the applr node has read them."""
        message = self._listener.latest(PARAMETERS, Parameters)
        # The applr node may have been started for another robot.
        if message is None or tuple(message.names) != self.space.names:
            return None
        return np.array(message.values, np.float64)

    def show_state(self) -> None:
        """Read the applr node's diagnostics, and update the dropdown and the sliders."""
        for message in self._listener.fresh(DIAGNOSTICS, DiagnosticArray):
            for status in message.status:
                # Diagnostics from before a request would set the dropdown back for a moment.
                if status.name == self._status and time.monotonic() - self._asked > ANSWER_S:
                    self._take_status(status)
        if self.source in self._methods:
            show(self.dropdown, self.source)
        theta = self.theta()
        if theta is None:
            return
        for slider, value in zip(self.sliders.values(), theta.tolist()):
            show(slider, round(min(max(value, slider.min), slider.max), 4))

    def _take_status(self, status: DiagnosticStatus) -> None:
        """Read method and problem of the applr node."""
        values = {pair.key: pair.value for pair in status.values}
        self.method = values.get("method", "")
        if self.method == "off":
            self.method = HAND
        self.trouble = "" if status.level == DiagnosticStatus.OK else status.message

    def _choose(self, method: str) -> None:
        """Select a method, or HAND to keep the current parameters."""
        if method == HAND:
            self._take_over()
            return
        # A slider may have switched the node off.
        is_set = self._ask("applr/set_method", SetMethod, method)
        if is_set and self._ask("applr/enable", SetBool, True):
            self.method = method

    def _take_over(self, **values: float) -> None:
        """Switch the method off and set parameters by hand. Other parameters stay as they are."""
        self._asked = time.monotonic()
        self.method = self.method and HAND
        message = Parameters(names=list(values), values=list(values.values()))
        publish(self.report, self._values, message)

    def _ask(self, *request: Any) -> bool:
        """Call a service as `call` does, and return whether it succeeded."""
        has_succeeded = call(self.report, *request)
        self._asked = time.monotonic()
        return has_succeeded

    def doing(self, goal: Any) -> str:
        """Return the state of move_base as text. goal: GoalStatus of the latest goal, or None."""
        if self._listener.age(STATUS) > SILENT_ON_PAGE_S:
            return "move_base does not answer"
        if goal is None:
            return "waiting for a goal"
        return f"goal {GOAL_STATES[goal.status]}"

    def monitor(self) -> str:
        """Return the action of the collision monitor as text."""
        action = self._listener.latest(ACTION, String)
        if action is None:
            return "no collision monitor"
        return f"monitor: {action.data}"

    def silence(self) -> List[str]:
        """Return a line for each node or topic that is silent."""
        topics = self._robot.topics
        sources = {"move_base": STATUS, "scan": topics.scan, "odometry": topics.odometry}
        lines = []
        for source_name, topic in sources.items():
            if self._listener.age(topic) > SILENT_ON_PAGE_S:
                lines.append(f"no {source_name}: nothing on {rospy.resolve_name(topic)}")
        if not self.method:
            lines.append("no applr node: parameters cannot be set")
        return lines
