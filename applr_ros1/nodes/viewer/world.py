"""The viewer's tab World: what a click does, which world and robot, and how fast simulated time goes."""

from __future__ import annotations

import base64
import contextlib
import io
import math
import random
import threading
from functools import lru_cache
from typing import Any, Dict, List

import rospy
from actionlib_msgs.msg import GoalID
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty, SetBool, Trigger
from visualization_msgs.msg import Marker

import worlds
from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.nodes.tools.send_goal import course_goal, message
from applr_ros1.robots import NAMES, Robot
from worlds import draw
from worlds.barn import COUNT
from worlds.metrics import difficulty

from .listening import Listener, Say, ask, by_hand, tell
from .page import sends

CURRENT = "sim_bridge/current_world"
TURN, GOAL, PUT, TAKE = "turns the view", "sets a goal", "puts an obstacle down", "takes an obstacle away"
ANY, MOVING = "any", "moving"
LEVELS = (ANY, "easy", "medium", "hard", MOVING)
MOVING_WORLDS = 1000  # of dynamic:N
TILES = 6  # pictures of worlds
RADIUS = 0.075  # m, of an obstacle that is put down: that of BARN's cylinders, at the Jackal's scale
FACTORS = (0.1, 5.0)  # of real time


class WorldTab:
    """What a person does with the world.

    Attributes:
        name: Of the simulated world, "" where there is none.
        course: Its worlds.Course; None where it is not known here.
        course_goal: Id of the last goal that was sent for it.
        robot, listener, say: As given: the description, what is heard, and what shows a line.
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, odom: str, say: Say):
        self.robot, self.listener, self.say, self._odom = robot, listener, say, odom
        self.course: Any = None
        self.course_goal, self.name, self._count = "", "", 0
        self._goal = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._world = rospy.Publisher("sim_bridge/world", String, queue_size=1)
        self._factor = rospy.Publisher("sim_bridge/real_time_factor", Float64, queue_size=1)
        self._obstacle = rospy.Publisher("sim_bridge/change_obstacle", Marker, queue_size=10)
        self._click = gui.add_dropdown("a click", (GOAL, PUT, TAKE, TURN))
        gui.add_button("back to the start").on_click(lambda _: self.reset())
        self.level = gui.add_dropdown("worlds", LEVELS)
        by_hand(self.level, lambda _: self._offer())
        self._tiles, self._offered = gui.add_html(""), {}  # type: Any, Dict[str, str]
        self._pressed = gui.add_text("pressed", "", visible=False)  # a tile
        by_hand(self._pressed, self.load)
        gui.add_button("other worlds").on_click(lambda _: self._offer())
        self._name = gui.add_text("world", "", hint="generated:N, fresh:N, dynamic:N, physical_course or a .world file")
        gui.add_button("load this world").on_click(lambda _: self.load(self._name.value))
        gui.add_markdown("Another robot: `./applr play robot:=NAME`, one of " + ", ".join(NAMES))
        moving = gui.add_checkbox("obstacles move", True)
        by_hand(moving, lambda on: ask(say, "sim_bridge/let_move", SetBool, on))
        by_hand(gui.add_checkbox("pause", False), lambda on: ask(say, "sim_bridge/pause", SetBool, on))
        gui.add_button("one step").on_click(lambda _: ask(say, "sim_bridge/step", Trigger))
        factor = gui.add_slider("real-time factor", *FACTORS, 0.1, initial_value=1.0)
        by_hand(factor, lambda value: tell(say, self._factor, value))

    def look(self) -> bool:
        """Take in which world is simulated. Returns whether it is another one."""
        if not self._offered:
            self._offered = {"": ""}
            threading.Thread(target=self._offer, daemon=True).start()
        told = self.listener.newest(CURRENT, String)
        another = told is not None and told.data != self.name
        if another:
            self.name = self._name.value = told.data
            self.course = None
            for spec in (str(rospy.get_param("sim_bridge/world", "")), self.name):
                with contextlib.suppress(ValueError, OSError):
                    world = worlds.load(spec)
                    if world.name == self.name:
                        self.course = worlds.scaled(world, self.robot.world_scale).course
            self._draw_tiles()
        return another

    def choose(self, count: int) -> Dict[str, str]:
        """{spec of a world: how hard it is}, by chance from those that the page asks for."""
        names, level = ranked(), self.level.value
        levels = {name: LEVELS[1 + 3 * place // len(names)] for place, name in enumerate(names)}
        known = [name for name in names if level in (ANY, levels[name])]
        if level == MOVING:
            known = [f"dynamic:{n}" for n in range(MOVING_WORLDS)]
        return {name: levels.get(name, MOVING) for name in random.sample(known, count)}

    def _offer(self) -> None:
        self._offered = self.choose(TILES)
        self._draw_tiles()

    def _draw_tiles(self) -> None:
        tiles = (
            f'<div {sends(self._pressed, name)} title="{name}"{" class=now" if name == self.name else ""}>'
            f"{drawing(name)}{level} {name.split(':')[-1]}</div>"
            for name, level in self._offered.items()
            if name
        )
        self._tiles.content = f'<div class="tiles">{"".join(tiles)}</div>'

    def clicked(self, ray: Any, pose: Any) -> None:
        """Do what the choice says where a click's ray meets the ground. pose: of the robot, in the fixed frame."""
        (x, y, z), (dx, dy, dz) = ray.ray_origin, ray.ray_direction
        if dz >= -1e-3 or self._click.value == TURN:
            return
        x, y = x - z / dz * dx, y - z / dz * dy
        if self._click.value == GOAL:
            yaw = math.atan2(y - pose[1], x - pose[0]) if pose else 0.0
            self._send((x, y, yaw), self.listener.fixed)
        else:
            self._change_obstacle(x, y)

    def _change_obstacle(self, x: float, y: float) -> None:
        place = self.listener.frame_pose("world")
        if place is None:
            self.say("no simulated world: obstacles stay as they are")
            return
        marker = Marker(action=Marker.ADD if self._click.value == PUT else Marker.DELETE, type=Marker.CYLINDER)
        marker.header.frame_id = "world"
        marker.pose.position.x, marker.pose.position.y = transform_point(inverse(place), x, y)
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = 2.0 * RADIUS * self.robot.world_scale
        tell(self.say, self._obstacle, marker)

    def _send(self, pose: Any, frame: str) -> str:
        """Send a goal (x, y, yaw) [m, m, rad] in a frame. Returns its id."""
        self._count += 1
        now = rospy.Time.now()
        goal = MoveBaseActionGoal(goal=message(pose, frame))
        goal.header.stamp = now
        goal.goal_id = GoalID(now, f"{rospy.get_name()}-{self._count}-{now.to_sec():.3f}")
        tell(self.say, self._goal, goal)
        return goal.goal_id.id

    def drive_course(self) -> str:
        """Send the course's goal. Returns its id, "" where no course is known."""
        if self.course is None:
            self.say("no course of this world is known: set a goal by a click")
            return ""
        self.course_goal = self._send(course_goal(self.course), self._odom)
        return self.course_goal

    def stop(self) -> None:
        """Cancel all goals."""
        tell(self.say, self._cancel, GoalID())

    def load(self, spec: str) -> None:
        """Change the simulated world; the robot stands at its start then."""
        self._pressed.value = ""
        try:
            worlds.load(spec)
        except (ValueError, OSError) as problem:
            self.say(str(problem))
            return
        self._cancel.publish(GoalID())
        tell(self.say, self._world, spec)

    def reset(self) -> bool:
        """Put the robot back to the start. Returns whether it stands there."""
        self._cancel.publish(GoalID())
        return ask(self.say, "sim_bridge/reset", Empty)


@lru_cache(maxsize=1)
def ranked() -> List[str]:
    """All generated worlds, those with most room first: mean distance to the closest obstacle along the path."""
    names = [f"generated:{n}" for n in range(COUNT)]
    return sorted(names, key=lambda name: -difficulty(worlds.load(name))["closest_obstacle"])


@lru_cache(maxsize=64)
def drawing(spec: str) -> str:
    """A small picture of a world from above, as HTML."""
    from matplotlib.figure import Figure

    figure, file = Figure((1.4, 1.4)), io.BytesIO()
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    world = worlds.load(spec)
    draw.draw(axes, world)
    if len(world.cylinders):  # the goal of BARN's courses lies far beyond the obstacles
        axes.set_ylim(world.cylinders[:, 1].min() - 0.3, world.cylinders[:, 1].max() + 0.3)
    axes.axis("off")
    figure.savefig(file, format="png", dpi=100)
    return f'<img alt="{spec}" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
