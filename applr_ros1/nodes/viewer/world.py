"""The viewer's tab World: which world, where to, what stands in the way, and how fast time goes in simulation."""

from __future__ import annotations

import math
import random
import threading
from functools import lru_cache
from typing import Any, Callable, List

import rospy
from actionlib_msgs.msg import GoalID
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty, SetBool, Trigger
from visualization_msgs.msg import Marker

import worlds
from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.common.errors import reason
from applr_ros1.nodes.tools.send_goal import course_goal, message
from applr_ros1.robots import Robot
from worlds.generator import COUNT
from worlds.metrics import difficulty

from .listening import Listener

CURRENT = "sim_bridge/current_world"
TOPICS = {CURRENT: String}
TURN, GOAL, PUT, TAKE = "turns the view", "sets a goal", "puts an obstacle down", "takes an obstacle away"
LEVELS = ("any", "easy", "middling", "hard")
RADIUS = 0.075  # m, of an obstacle that is put down: that of BARN's cylinders, at the Jackal's scale
FACTORS = (0.1, 5.0)  # of real time


class WorldTab:
    """What a person does with the world.

    Args:
        gui: viser's; the elements are added where its context is.
        robot: Description of the robot.
        listener: Has TOPICS.
        odom: Frame in which goals are sent.
        say: Shows one line to everybody who looks.

    Attributes:
        name: Of the simulated world, "" where there is none.
        course: Its worlds.Course; None where it is not known here.
        course_goal: Id of the last goal that was sent for it.
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, odom: str, say: Callable[[str], None]):
        self._robot, self._listener, self._odom, self.say = robot, listener, odom, say
        self.course, self.course_goal, self.name, self._count = None, "", "", 0
        self._goal = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._world = rospy.Publisher("sim_bridge/world", String, queue_size=1)
        self._factor = rospy.Publisher("sim_bridge/real_time_factor", Float64, queue_size=1)
        self._obstacle = rospy.Publisher("sim_bridge/change_obstacle", Marker, queue_size=10)
        self.click = gui.add_dropdown("a click", (TURN, GOAL, PUT, TAKE), initial_value=GOAL)
        for text, work in (("drive the course", self.drive_course), ("stop", self.stop)):
            self._button(gui, text, work)
        self._name = gui.add_text("world", "")
        self._button(gui, "load this world", lambda: self.load(self._name.value))
        self._level = gui.add_dropdown("difficulty", LEVELS)
        self._button(gui, "next world", lambda: self.load(another(self._level.value)))
        self._button(gui, "back to the start", self.reset)
        moving = gui.add_checkbox("moving obstacles", True)
        paused = gui.add_checkbox("pause", False)
        moving.on_update(lambda event: event.client and self._call("let_move", SetBool, moving.value))
        paused.on_update(lambda event: event.client and self._call("pause", SetBool, paused.value))
        self._button(gui, "one step", lambda: self._call("step", Trigger))
        factor = gui.add_slider("real-time factor", *FACTORS, 0.1, initial_value=1.0)
        factor.on_update(lambda event: event.client and self._factor.publish(factor.value))

    def _button(self, gui: Any, text: str, work: Callable[[], Any]) -> None:
        gui.add_button(text).on_click(lambda _: work())

    def look(self) -> None:
        """Take in which world is simulated."""
        told = self._listener.newest(CURRENT)
        if told is not None and told.data != self.name:
            self.name = self._name.value = told.data
            self.course = None
            threading.Thread(target=self._find_course, args=(told.data,), daemon=True).start()

    def _find_course(self, name: str) -> None:
        for spec in (name, str(rospy.get_param("sim_bridge/world", ""))):
            try:
                world = worlds.load(spec)
            except (ValueError, OSError):
                continue
            if world.name == name == self.name:
                self.course = worlds.scaled(world, self._robot.world_scale).course
                return

    def clicked(self, ray: Any, pose: Any) -> None:
        """Do what the choice says where a click's ray meets the ground. pose: of the robot, in the fixed frame."""
        (x, y, z), (dx, dy, dz) = ray.ray_origin, ray.ray_direction
        if dz >= -1e-3 or self.click.value == TURN:
            return
        x, y = x - z / dz * dx, y - z / dz * dy
        if self.click.value == GOAL:
            yaw = math.atan2(y - pose[1], x - pose[0]) if pose else 0.0
            self.send((x, y, yaw), self._listener.fixed)
        else:
            self._change_obstacle(x, y)

    def _change_obstacle(self, x: float, y: float) -> None:
        place = self._listener.place("world")
        if place is None or not self._obstacle.get_num_connections():
            self.say("no simulated world: obstacles stay as they are")
            return
        marker = Marker(action=Marker.ADD if self.click.value == PUT else Marker.DELETE, type=Marker.CYLINDER)
        marker.header.frame_id = "world"
        marker.pose.position.x, marker.pose.position.y = transform_point(inverse(place), x, y)
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = 2.0 * RADIUS * self._robot.world_scale
        self._obstacle.publish(marker)

    def send(self, pose: Any, frame: str) -> str:
        """Send a goal (x, y, yaw) [m, m, rad] in a frame. Returns its id."""
        if not self._goal.get_num_connections():
            self.say("no move_base: nobody takes goals on %s" % self._goal.resolved_name)
        self._count += 1
        now = rospy.Time.now()
        goal = MoveBaseActionGoal(goal=message(pose, frame))
        goal.header.stamp = now
        goal.goal_id = GoalID(now, "%s-%d-%.3f" % (rospy.get_name(), self._count, now.to_sec()))
        self._goal.publish(goal)
        return goal.goal_id.id

    def drive_course(self) -> str:
        """Send the course's goal. Returns its id, "" where no course is known."""
        if self.course is None:
            self.say("no course of this world is known: set a goal by a click")
            return ""
        self.course_goal = self.send(course_goal(self.course), self._odom)
        return self.course_goal

    def stop(self) -> None:
        """Cancel all goals."""
        self._cancel.publish(GoalID())

    def load(self, spec: str) -> None:
        """Change the simulated world; the robot stands at its start then."""
        try:
            worlds.load(spec)
        except (ValueError, OSError) as problem:
            self.say(str(problem))
            return
        self.stop()
        self._world.publish(spec)

    def reset(self) -> str:
        """Put the robot back to the start. Returns "" or one line why not."""
        self.stop()
        return self._call("reset", Empty)

    def _call(self, name: str, kind: Any, *request: Any) -> str:
        try:
            rospy.wait_for_service("sim_bridge/" + name, 1.0)
            answer = rospy.ServiceProxy("sim_bridge/" + name, kind)(*request)
            problem = "" if getattr(answer, "success", True) else answer.message
        except rospy.ROSException:
            problem = "no simulated robot: sim_bridge/%s does not answer" % name
        except rospy.ServiceException as error:
            problem = reason(error)
        if problem:
            self.say(problem)
        return problem


def another(level: str) -> str:
    """A generated world of a level, by the mean distance to the closest obstacle along its path."""
    ranked = _ranked()
    third = len(ranked) // 3
    k = LEVELS.index(level) - 1
    return random.choice(ranked if k < 0 else ranked[k * third : (k + 1) * third])


@lru_cache(maxsize=1)
def _ranked() -> List[str]:
    """All generated worlds, those with most room first."""
    room = {world.name: difficulty(world)["closest_obstacle"] for world in map(worlds.load, _generated())}
    return sorted(room, key=lambda name: -room[name])


def _generated() -> List[str]:
    return ["generated:%d" % n for n in range(COUNT)]
