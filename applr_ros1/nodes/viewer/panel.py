"""The viewer's panel: what the robot does, who sets its parameters, a slider for each of them, and how they went."""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Any, Callable, Deque, Dict

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from applr_ros1.policy.methods.registry import shipped
from applr_ros1.policy.parameter_space import Space
from applr_ros1.robots import Robot

from .listening import Listener
from .pilot import HAND, Pilot

STATUS, ACTION = "move_base/status", "collision_monitor/action"
METHODS = {  # what the page calls them
    "dwa": "default parameters",
    "static": "best single set",
    "appld": "APPLD",
    "applr": "policy",
    HAND: HAND,
}
FILES = {"static": "static.json", "appld": "appld.safetensors", "applr": "applr.safetensors"}  # that a robot may lack
WORDS = {
    GoalStatus.PENDING: "has a goal that waits",
    GoalStatus.ACTIVE: "drives to a goal",
    GoalStatus.PREEMPTED: "goal cancelled",
    GoalStatus.SUCCEEDED: "goal reached",
    GoalStatus.ABORTED: "gave up",
    GoalStatus.REJECTED: "goal rejected",
    GoalStatus.PREEMPTING: "goal being cancelled",
    GoalStatus.RECALLED: "goal cancelled",
}
SPAN = 30.0  # s that the plots show
PLOTTED = 0.5  # wall seconds between two looks of the plots
SILENT = 3.0  # wall seconds after which a topic counts as silent
TOUCHED = 1.5  # wall seconds for which a slider that was moved is left alone
PALETTE = ("#2f6fde", "#d9480f", "#2b8a3e", "#9c36b5", "#e8590c", "#0c8599", "#c2255c", "#5c940d")


def topics(robot: Robot) -> Dict[str, Any]:
    """{topic: class} of what the panel shows of a robot."""
    return {STATUS: GoalStatusArray, ACTION: String, robot.topics.odometry: Odometry}


def goal_status(listener: Listener) -> Any:
    """The actionlib_msgs/GoalStatus of move_base's newest goal, None without one."""
    message = listener.newest(STATUS)
    goals = message.status_list if message is not None else []
    return max(goals, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


class Panel:
    """The panel's first tab and the lines above all tabs.

    Args:
        gui: viser's; the elements are added where its context is.
        robot: Description of the robot.
        listener: Has the topics of `topics(robot)`.
        pilot: Who sets the parameters.
        say: Shows one line to everybody who looks.
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, pilot: Pilot, say: Callable[[str], None]):
        self._robot, self._listener, self._pilot, self._say, self.speed = robot, listener, pilot, say, 0.0
        self._touched: Dict[str, float] = {}
        self._history: Deque[Any] = deque(maxlen=int(SPAN * 10.0))  # (ROS time, speed, shares of the ranges)
        self._plotted = 0.0
        names = self.methods = [name for name in METHODS if name not in FILES or _exists(FILES[name], robot)]
        self._method = gui.add_dropdown("parameters by", [METHODS[name] for name in names])
        self._method.on_update(self._choose)
        self._back = gui.add_button("hand back to the policy", visible="applr" in names)
        self._back.on_click(lambda _: self._tell(pilot.hand_to("applr")))
        space = pilot.space
        self.sliders = {name: self._slider(gui, space, i) for i, name in enumerate(space.names)}
        nothing = np.array([0.0, SPAN])
        width = {"width": 1.5, "points": {"show": False}}
        self._speed_plot = gui.add_uplot(
            (nothing, 0.0 * nothing),
            ({}, {"label": "speed [m/s]", "stroke": PALETTE[0], **width}),
            scales={"x": {"time": False}, "y": {"range": [-0.5, max(1.0, robot.base.max_speed)]}},
            title="speed [m/s]",
            legend={"show": False},
            height=150,
        )
        series = [{"label": name, "stroke": PALETTE[i % 8], **width} for i, name in enumerate(space.names)]
        self._plot = gui.add_uplot(
            (nothing, *[0.0 * nothing for _ in series]),
            ({}, *series),
            scales={"x": {"time": False}, "y": {"range": [-0.05, 1.05]}},
            title="parameters, from least to most",
            height=240,
        )

    def _slider(self, gui: Any, space: Space, i: int) -> Any:
        name, whole = space.names[i], bool(space.integer[i])
        kind = int if whole else float
        low, high, default = (kind(values[i]) for values in (space.low, space.high, space.theta0))
        step = 1 if whole else 0.01
        slider = gui.add_slider(
            name, low, high, step, initial_value=min(max(default, low), high), marks=((default, "default"),)
        )

        def moved(event: Any) -> None:
            if event.client is not None:  # a person's hand, not this program
                self._touched[name] = time.monotonic()
                self._tell(self._pilot.take_over(name, float(slider.value)))

        slider.on_update(moved)
        return slider

    def _choose(self, event: Any) -> None:
        if event.client is None:
            return
        method = next(name for name, shown in METHODS.items() if shown == self._method.value)
        self._tell(self._pilot.hold() if method == HAND else self._pilot.hand_to(method))

    def _tell(self, problem: str) -> None:
        if problem:
            self._say(problem)

    def look(self) -> str:
        """Bring everything up to date. Returns the lines above the tabs, in Markdown."""
        odometry = self._listener.newest(self._robot.topics.odometry)
        self.speed = odometry.twist.twist.linear.x if odometry is not None else 0.0
        self._pilot.look()
        theta, space = self._pilot.theta(), self._pilot.space
        shown = METHODS.get(self._pilot.method)
        if shown in self._method.options:
            self._method.value = shown
        if theta is not None:
            for name, value in zip(space.names, theta):
                slider = self.sliders[name]
                inside = min(max(float(value), slider.min), slider.max)
                if time.monotonic() - self._touched.get(name, -TOUCHED) >= TOUCHED:
                    slider.value = round(inside, 4)
            shares = (theta - space.low) / (space.high - space.low)
            self._history.append((rospy.get_time(), self.speed, *shares))
        self._draw_plots()
        return "  \n".join([*self._lines(), *("**%s**" % line for line in self._silence())])

    def _draw_plots(self) -> None:
        if len(self._history) < 2 or time.monotonic() - self._plotted < PLOTTED:
            return
        self._plotted = time.monotonic()
        rows = np.array(self._history)
        if (np.diff(rows[:, 0]) < 0.0).any():  # the clock went back
            self._history.clear()
            return
        rows = rows[rows[:, 0] >= rows[-1, 0] - SPAN]
        self._speed_plot.data = rows[:, 0], rows[:, 1]
        self._plot.data = (rows[:, 0], *rows[:, 2:].T)

    def _lines(self) -> Any:
        goal = goal_status(self._listener)
        if self._listener.age(STATUS) > SILENT:
            doing = "does not answer"
        else:
            doing = "waits for a goal" if goal is None else WORDS.get(goal.status, "goal in state %d" % goal.status)
        method = METHODS.get(self._pilot.method, self._pilot.method) or "nobody"
        yield "move_base **%s**, %.2f m/s, parameters by **%s**" % (doing, self.speed, method)
        action = self._listener.newest(ACTION)
        if action is not None:
            yield "collision monitor: %s" % action.data

    def _silence(self) -> Any:
        """What does not answer."""
        age, robot = self._listener.age, self._robot
        if age(STATUS) > SILENT:
            yield "no move_base: nothing on %s" % rospy.resolve_name(STATUS)
        elif self._pilot.trouble:
            yield self._pilot.trouble
        for what, topic in (("scan", robot.topics.scan), ("odometry", robot.topics.odometry)):
            if age(topic) > SILENT:
                yield "no %s: nothing on %s" % (what, rospy.resolve_name(topic))
        if not self._pilot.method:
            yield "no applr node: sliders set the planner directly"


def _exists(name: str, robot: Robot) -> bool:
    return os.path.exists(shipped(name, robot))
