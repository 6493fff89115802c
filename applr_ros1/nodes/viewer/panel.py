"""The viewer's tab Drive: who sets the parameters, a slider for each of them, and how three chosen curves went."""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Any, Deque, Dict, List, Optional

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from std_msgs.msg import String

from applr_ros1.msg import Decision
from applr_ros1.planner.parameters.declarations import SERVERS
from applr_ros1.policy.methods.registry import shipped
from applr_ros1.robots import Robot

from .listening import Listener, by_hand, show
from .pilot import METHODS, Pilot
from .shapes import PALETTE, SEEN

STATUS, ACTION, DECISION = "move_base/status", "collision_monitor/action", "applr/decision"
FILES = {"static": "static.json", "appld": "appld.safetensors"}  # that a robot may lack
WORDS = ("has a goal that waits", "drives to a goal", "goal cancelled", "goal reached", "gave up", "goal rejected")
WORDS += ("goal being cancelled", "goal being cancelled", "goal cancelled", "goal lost")  # by GoalStatus.status
UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING)
SPEED, CLEARANCE = "speed [m/s]", "clearance ahead [m]"
CURVES = 3
SPAN = 30.0  # s that the plots show
PLOTTED = 0.5  # wall seconds between two looks of the plots
SILENT = 3.0  # seconds after which a topic counts as silent, the clock as standing
STANDING = 0.02  # m/s, below which the speed is noise


def goal_status(listener: Listener) -> Any:
    """The actionlib_msgs/GoalStatus of move_base's newest goal, None without one."""
    message = listener.newest(STATUS, GoalStatusArray)
    goals = message.status_list if message is not None else []
    return max(goals, key=lambda goal: goal.goal_id.stamp.to_sec(), default=None)


def described(target: Any, name: str) -> List[str]:
    """[name with its unit, sentence about it] of what a parameter sets, by the planner's declarations."""
    rows = SERVERS.get(target.server, SERVERS["local_costmap/inflater_layer"])
    found = next((p for p in rows if p.name in target.names), None)
    return [f"{name} [{found.unit}]" if found and found.unit else name, found.doc if found else ""]


class Panel:
    """gui: viser's, in the context where the panel is to be."""

    def __init__(self, gui: Any, robot: Robot, listener: Listener, pilot: Pilot):
        self._robot, self._listener, self._pilot = robot, listener, pilot
        space, targets = pilot.space, pilot.space.targets
        self.titles = {name: described(targets[name][0], name) for name in space.names}
        self._history: Deque[Any] = deque(maxlen=int(SPAN * 10.0))  # (ROS time, changed, speed, clearance, theta)
        self._plotted = 0.0
        there = [name for name in METHODS if name not in FILES or os.path.exists(shipped(FILES[name], robot))]
        self.methods = {METHODS[name]: name for name in there}
        self._method = gui.add_dropdown("parameters by", tuple(self.methods))
        by_hand(self._method, lambda shown: pilot.choose(self.methods[shown]))
        self.sliders = {name: self._slider(gui, i) for i, name in enumerate(space.names)}
        ends = zip(space.low.tolist(), space.high.tolist())
        self._curves = {SPEED: (-0.1 * robot.base.max_speed, robot.base.max_speed), CLEARANCE: (0.0, SEEN)}
        self._curves.update({self.titles[name][0]: end for name, end in zip(space.names, ends)})
        gui.add_markdown(f"The last {SPAN:.0f} s; dots where the policy changed a parameter:")
        self._plots = [self._plot(gui, k) for k in range(CURVES)]

    def _slider(self, gui: Any, i: int) -> Any:
        space = self._pilot.space
        name, kind, step = space.names[i], *((int, 1) if space.integer[i] else (float, 0.01))
        low, high, default = (kind(values[i]) for values in (space.low, space.high, space.theta0))
        look: Dict[str, Any] = {"initial_value": min(max(default, low), high), "marks": ((default, "default"),)}
        title, sentence = self.titles[name]
        slider = gui.add_slider(title, low, high, step, hint=sentence, **look)
        by_hand(slider, lambda value: self._pilot.take_over(name, float(value)))
        return slider

    def _plot(self, gui: Any, k: int) -> Any:
        """(what chooses the curve, the curve)."""
        chosen = gui.add_dropdown(f"curve {k + 1}", tuple(self._curves), initial_value=list(self._curves)[k])
        colour = "rgb(%d, %d, %d)" % PALETTE[k]
        line = {"stroke": colour, "width": 1.5, "points": {"show": False}}
        dots = {"stroke": colour, "width": 0, "points": {"show": True, "size": 7, "fill": colour}}
        nothing = (np.array([-SPAN, 0.0]), np.zeros(2), np.full(2, np.nan))
        look: Dict[str, Any] = {"scales": self._scales(chosen.value), "legend": {"show": False}, "height": 110}
        plot = gui.add_uplot(nothing, ({}, line, dots), **look)
        chosen.on_update(lambda _: setattr(plot, "scales", self._scales(chosen.value)))
        return chosen, plot

    def _scales(self, curve: str) -> Dict[str, Any]:
        low, high = self._curves[curve]
        room = 0.1 * (high - low)  # so that the labels at the ends are whole
        return {"x": {"time": False, "range": (-SPAN, 0.0)}, "y": {"range": (low - room, high + room)}}

    def look(self, speed: float, clearance: Optional[float]) -> None:
        """Bring everything up to date. speed [m/s]; clearance [m] to the next obstacle ahead, None where unknown."""
        self._pilot.look()
        theta, made = self._pilot.theta(), self._listener.fresh(DECISION, Decision)
        changed = any(not np.array_equal(one.before.values, one.after.values) for one in made)
        if self._pilot.who in self.methods:
            show(self._method, self._pilot.who)
        if theta is not None:
            for slider, value in zip(self.sliders.values(), theta):
                show(slider, round(min(max(float(value), slider.min), slider.max), 4))
            row = (speed, np.nan if clearance is None else clearance, *theta)
            self._history.append((rospy.get_time(), changed, *row))
        if len(self._history) < 2 or time.monotonic() - self._plotted < PLOTTED:
            return
        self._plotted = time.monotonic()
        rows = np.array(self._history)
        if (np.diff(rows[:, 0]) < 0.0).any():  # the clock went back
            self._history.clear()
            return
        times, dots, *curves = rows[rows[:, 0] >= rows[-1, 0] - SPAN].T
        for chosen, plot in self._plots:
            curve = curves[list(self._curves).index(chosen.value)]
            plot.data = (times - times[-1], curve, np.where(dots > 0, curve, np.nan))

    def forget(self) -> None:
        """The curves begin anew."""
        self._history.clear()

    def doing(self, goal: Any) -> str:
        """What move_base does. goal: its GoalStatus, None without one."""
        if self._listener.age(STATUS) > SILENT:
            return "move_base does not answer"
        return "waits for a goal" if goal is None else WORDS[goal.status]

    def monitor(self) -> str:
        """What the collision monitor does; "" without one."""
        action = self._listener.newest(ACTION, String)
        return "" if action is None else f"monitor: {action.data}"

    def silence(self) -> List[str]:
        """What does not answer, a line each."""
        age, robot, lines = self._listener.age, self._robot, []
        if age(STATUS) > SILENT:
            lines.append(f"no move_base: nothing on {rospy.resolve_name(STATUS)}")
        elif self._pilot.trouble:
            lines.append(self._pilot.trouble)
        for what, topic in (("scan", robot.topics.scan), ("odometry", robot.topics.odometry)):
            if age(topic) > SILENT:
                lines.append(f"no {what}: nothing on {rospy.resolve_name(topic)}")
        if not self._pilot.method:
            lines.append("no applr node: sliders set the planner directly")
        return lines
