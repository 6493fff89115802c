"""The viewer's panel: what the robot does, who sets its parameters, a slider for each of them, and how they went."""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Any, Deque, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatusArray
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from applr_ros1.policy.methods.registry import shipped
from applr_ros1.robots import Robot

from .listening import Listener, by_hand, show
from .pilot import METHODS, Pilot
from .shapes import PALETTE

STATUS, ACTION = "move_base/status", "collision_monitor/action"
FILES = {"static": "static.json", "appld": "appld.safetensors"}  # that a robot may lack
WORDS = ("has a goal that waits", "drives to a goal", "goal cancelled", "goal reached", "gave up", "goal rejected")
WORDS += ("goal being cancelled", "goal being cancelled", "goal cancelled", "goal lost")  # by GoalStatus.status
SPAN = 30.0  # s that the plots show
PLOTTED = 0.5  # wall seconds between two looks of the plots
SILENT = 3.0  # wall seconds after which a topic counts as silent


def goal_status(listener: Listener) -> Any:
    """The actionlib_msgs/GoalStatus of move_base's newest goal, None without one."""
    message = listener.newest(STATUS, GoalStatusArray)
    goals = message.status_list if message is not None else []
    return max(goals, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


class Panel:
    """The panel's first tab and the lines above all tabs. gui: viser's, in the context where it is to be."""

    def __init__(self, gui: Any, robot: Robot, listener: Listener, pilot: Pilot):
        self._robot, self._listener, self._pilot, self.speed = robot, listener, pilot, 0.0
        self._history: Deque[Any] = deque(maxlen=int(SPAN * 10.0))  # (ROS time, speed, shares of the ranges)
        self._plotted = 0.0
        there = [name for name in METHODS if name not in FILES or os.path.exists(shipped(FILES[name], robot))]
        self.methods = {METHODS[name]: name for name in there}
        self._method = gui.add_dropdown("parameters by", tuple(self.methods))
        by_hand(self._method, lambda shown: pilot.choose(self.methods[shown]))
        back = gui.add_button("hand back to the policy", visible="applr" in there)
        back.on_click(lambda _: pilot.choose("applr"))
        self.sliders = {name: self._slider(gui, i) for i, name in enumerate(pilot.space.names)}
        fastest = max(1.0, robot.base.max_speed)
        self._speed_plot = _plot(gui, "speed [m/s]", ("speed [m/s]",), (-0.5, fastest + 0.2), 150)
        self._plot = _plot(gui, "parameters, from least to most", pilot.space.names, (-0.05, 1.05), 240)

    def _slider(self, gui: Any, i: int) -> Any:
        space = self._pilot.space
        name, kind, step = space.names[i], *((int, 1) if space.integer[i] else (float, 0.01))
        low, high, default = (kind(values[i]) for values in (space.low, space.high, space.theta0))
        first = min(max(default, low), high)
        slider = gui.add_slider(name, low, high, step, initial_value=first, marks=((default, "default"),))
        by_hand(slider, lambda value: self._pilot.take_over(name, float(value)))
        return slider

    def look(self) -> str:
        """Bring everything up to date. Returns the lines above the tabs, in Markdown."""
        odometry = self._listener.newest(self._robot.topics.odometry, Odometry)
        self.speed = odometry.twist.twist.linear.x if odometry is not None else 0.0
        self._pilot.look()
        theta, space = self._pilot.theta(), self._pilot.space
        if self._pilot.who in self.methods:
            show(self._method, self._pilot.who)
        if theta is not None:
            for slider, value in zip(self.sliders.values(), theta):
                show(slider, round(min(max(float(value), slider.min), slider.max), 4))
            self._history.append((rospy.get_time(), self.speed, *(theta - space.low) / (space.high - space.low)))
        self._draw_plots()
        return "  \n".join([*self._lines(), *(f"**{line}**" for line in self._silence())])

    def _draw_plots(self) -> None:
        if len(self._history) < 2 or time.monotonic() - self._plotted < PLOTTED:
            return
        self._plotted = time.monotonic()
        rows = np.array(self._history)
        if (np.diff(rows[:, 0]) < 0.0).any():  # the clock went back
            self._history.clear()
            return
        times, speed, *shares = rows[rows[:, 0] >= rows[-1, 0] - SPAN].T
        self._speed_plot.data, self._plot.data = (times, speed), (times, *shares)

    def _lines(self) -> Any:
        goal = goal_status(self._listener)
        if self._listener.age(STATUS) > SILENT:
            doing = "does not answer"
        else:
            doing = "waits for a goal" if goal is None else WORDS[goal.status]
        speed = round(self.speed, 2) + 0.0  # never -0.00
        yield f"move_base **{doing}**, {speed:.2f} m/s, parameters by **{self._pilot.who}**"
        action = self._listener.newest(ACTION, String)
        if action is not None:
            yield f"collision monitor: {action.data}"

    def _silence(self) -> Any:
        """What does not answer."""
        age, robot = self._listener.age, self._robot
        if age(STATUS) > SILENT:
            yield f"no move_base: nothing on {rospy.resolve_name(STATUS)}"
        elif self._pilot.trouble:
            yield self._pilot.trouble + " (a recorded drive can only be looked at)" * (not self._pilot.client.connected)
        for what, topic in (("scan", robot.topics.scan), ("odometry", robot.topics.odometry)):
            if age(topic) > SILENT:
                yield f"no {what}: nothing on {rospy.resolve_name(topic)}"
        if not self._pilot.method:
            yield "no applr node: sliders set the planner directly"


def _plot(gui: Any, title: str, names: Tuple[str, ...], ends: Tuple[float, float], height: int) -> Any:
    """Curves of the last SPAN seconds; ends: of the vertical axis, height [pixels]."""
    shown = {"width": 1.5, "points": {"show": False}}
    strokes = ["rgb(%d, %d, %d)" % colour for colour in PALETTE]
    curves = [{"label": name, "stroke": strokes[i % len(strokes)], **shown} for i, name in enumerate(names)]
    return gui.add_uplot(
        (np.array([0.0, SPAN]), *[np.zeros(2)] * len(names)),
        ({}, *curves),
        scales={"x": {"time": False}, "y": {"range": ends}},
        title=title,
        legend={"show": len(names) > 1},
        height=height,
    )
