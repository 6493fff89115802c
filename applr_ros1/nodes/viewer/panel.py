"""The viewer's tab Drive, with the method and a slider for each parameter, and the texts of the page's status."""

from __future__ import annotations

import os
from typing import Any, List

import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from std_msgs.msg import String

from applr_ros1.nodes.conversions import GOAL_STATES
from applr_ros1.planner.parameters.declarations import SERVERS
from applr_ros1.policy.methods import POLICY, SET, shipped
from applr_ros1.robots import Robot

from .listening import Listener, by_hand, show
from .pilot import METHODS, MethodSelector

STATUS, ACTION = "move_base/status", "collision_monitor/action"
FILES = {"applr": POLICY, "static": SET, "appld": "appld.safetensors"}  # files of methods, which a robot may lack
UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING)
SILENT_S = 3.0  # time without a message after which a topic counts as silent, and the clock as stopped [s]
STANDING_M_S = 0.02  # speed below which the robot counts as at rest [m/s]


def goal_status(listener: Listener) -> Any:
    """Return the actionlib_msgs/GoalStatus of move_base's latest goal, or None if there is none."""
    message = listener.latest(STATUS, GoalStatusArray)
    goals = message.status_list if message is not None else []
    return max(goals, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


class Panel:
    """Dropdown of methods and sliders for parameters, in the current container of viser's `gui`.

    Attributes:
        sliders: Sliders by the name of the parameter.
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, pilot: MethodSelector):
        self._robot, self._listener, self._pilot = robot, listener, pilot
        there = [name for name in METHODS if name not in FILES or os.path.exists(shipped(FILES[name], robot))]
        self._methods = {METHODS[name]: name for name in there}  # methods by their names on the page
        self._method = gui.add_dropdown("parameters by", tuple(self._methods))
        by_hand(self._method, lambda shown: pilot.choose(self._methods[shown]))
        self.sliders = {name: self._slider(gui, i) for i, name in enumerate(pilot.space.names)}

    def _slider(self, gui: Any, i: int) -> Any:
        """Return the slider of the i-th parameter, with unit and description from the planner's declaration."""
        space = self._pilot.space
        name, kind, step = space.names[i], *((int, 1) if space.integer[i] else (float, 0.01))
        low, high, default = (kind(values[i]) for values in (space.low, space.high, space.theta0))
        target = space.targets[name][0]
        rows = SERVERS.get(target.server, SERVERS["local_costmap/inflater_layer"])
        declared = next((p for p in rows if p.name in target.names), None)
        title = f"{name} [{declared.unit}]" if declared and declared.unit else name
        look = {"marks": ((default, "default"),), "hint": declared.doc if declared else ""}
        slider = gui.add_slider(title, low, high, step, initial_value=min(max(default, low), high), **look)
        by_hand(slider, lambda value: self._pilot.take_over(**{name: float(value)}))
        return slider

    def update(self) -> None:
        """Update the dropdown and the sliders."""
        self._pilot.update()
        if self._pilot.source in self._methods:
            show(self._method, self._pilot.source)
        theta = self._pilot.theta()
        for slider, value in zip(self.sliders.values(), theta if theta is not None else ()):
            show(slider, round(min(max(float(value), slider.min), slider.max), 4))

    def doing(self, goal: Any) -> str:
        """Return the state of move_base as text. goal: its GoalStatus, or None."""
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
        elif self._pilot.trouble:
            lines.append(self._pilot.trouble)
        for what, topic in (("scan", robot.topics.scan), ("odometry", robot.topics.odometry)):
            if age(topic) > SILENT_S:
                lines.append(f"no {what}: nothing on {rospy.resolve_name(topic)}")
        if not self._pilot.method:
            lines.append("no applr node: parameters cannot be set")
        return lines
