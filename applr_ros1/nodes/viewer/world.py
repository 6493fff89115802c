"""The viewer's tab World: which world, and how simulated time goes; and the goals that a person sends."""

from __future__ import annotations

import contextlib
import math
import time
from typing import Any, Optional

import rospy
from actionlib_msgs.msg import GoalID
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty, SetBool, Trigger

import worlds
from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.nodes.tools.send_goal import course_goal, message
from applr_ros1.robots import NAMES, Robot
from worlds.barn import COUNT

from .listening import Listener, Say, by_hand, call, publish

CURRENT = "sim_bridge/current_world"
MOVING_WORLDS = 100  # of dynamic:N that the list offers
LISTED = (
    "physical_course",
    *(f"generated:{n}" for n in range(COUNT)),
    *(f"dynamic:{n}" for n in range(MOVING_WORLDS)),
)
FACTORS = (0.1, 5.0)  # of real time
SETTLING_S = 1.0  # of wall time between a reset and the next goal: the costmaps see the world again


class WorldTab:
    """The world: which one is simulated, its course, and goals.

    Attributes:
        name: Of the simulated world, "" where there is none.
        course: Its worlds.Course; None where it is not known here.
        ended: Id of the last goal whose course was driven to its end.
    """

    def __init__(self, gui: Any, robot: Robot, listener: Listener, odom: str, say: Say):
        self._robot, self._listener, self._say, self._odom = robot, listener, say, odom
        self.course: Any = None
        self.name, self.ended, self._course_goal, self._count = "", "", "", 0
        self._goal = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._world = rospy.Publisher("sim_bridge/world", String, queue_size=1)
        self._factor = rospy.Publisher("sim_bridge/real_time_factor", Float64, queue_size=1)
        self._listed = gui.add_dropdown("world", LISTED)
        by_hand(self._listed, self.load)
        self._typed = gui.add_text("other world", "", hint="fresh:N, or the path of a .world file")
        gui.add_button("load the other world").on_click(lambda _: self.load(self._typed.value))
        gui.add_button("back to the start").on_click(lambda _: self.reset())
        moving = gui.add_checkbox("obstacles move", True)
        by_hand(moving, lambda on: call(say, "sim_bridge/let_move", SetBool, on))
        by_hand(gui.add_checkbox("pause", False), lambda on: call(say, "sim_bridge/pause", SetBool, on))
        gui.add_button("one step").on_click(lambda _: call(say, "sim_bridge/step", Trigger))
        factor = gui.add_slider("real-time factor", *FACTORS, 0.1, initial_value=1.0)
        by_hand(factor, lambda value: publish(say, self._factor, Float64(value)))
        gui.add_markdown(f"Another robot starts with `./applr play robot:=NAME`: {', '.join(NAMES)}.")

    def look(self) -> bool:
        """Take in which world is simulated. Returns whether it is another one."""
        current = self._listener.newest(CURRENT, String)
        if current is None or current.data == self.name:
            return False
        self.name, self.course = current.data, None
        if self.name in LISTED:
            self._listed.value = self.name
        for spec in (str(rospy.get_param("sim_bridge/world", "")), self.name):
            with contextlib.suppress(ValueError, OSError):
                world = worlds.load(spec)
                if world.name == self.name:
                    self.course = worlds.scaled(world, self._robot.world_scale).course
        return True

    def clicked(self, ray: Any, pose: Any) -> None:
        """Send a goal to where a click's ray meets the ground. pose: of the robot, in the fixed frame."""
        (x, y, z), (dx, dy, dz) = ray.ray_origin, ray.ray_direction
        if dz < -1e-3:
            x, y = x - z / dz * dx, y - z / dz * dy
            yaw = math.atan2(y - pose[1], x - pose[0]) if pose else 0.0
            self._send((x, y, yaw), self._listener.fixed)

    def _send(self, pose: Any, frame: str) -> str:
        """Send a goal (x, y, yaw) [m, m, rad] in a frame. Returns its id."""
        self._count += 1
        now = rospy.Time.now()
        goal = MoveBaseActionGoal(goal=message(pose, frame))
        goal.header.stamp = now
        goal.goal_id = GoalID(now, f"{rospy.get_name()}-{self._count}-{now.to_sec():.3f}")
        publish(self._say, self._goal, goal)
        return goal.goal_id.id

    def go(self, pose: Optional[Pose]) -> None:
        """Drive the course; a robot at its end goes back to the start first. pose: of the robot, in the fixed frame."""
        if self.course is None:
            self._say("no course of this world is known: set a goal by a click")
            return
        if self._is_done(pose) and self.reset():
            time.sleep(SETTLING_S)
        self._course_goal = self._send(course_goal(self.course), self._odom)

    def end_course(self, pose: Optional[Pose], goal: str) -> None:
        """Cancel the course's goal where the robot is at the end of the course. goal: id of the one being driven to."""
        if goal and goal == self._course_goal and goal != self.ended and self._is_done(pose):
            self.ended = goal
            self.stop()

    def _is_done(self, pose: Optional[Pose]) -> bool:
        """Return whether the robot is at the end of the course."""
        place, course = self._listener.frame_pose("world"), self.course
        at = transform_point(inverse(place), *pose[:2]) if place and pose else None
        return at is not None and course is not None and course.arrived(*at)

    def stop(self) -> None:
        """Cancel all goals."""
        publish(self._say, self._cancel, GoalID())

    def load(self, spec: str) -> None:
        """Change the simulated world; the robot stands at its start then."""
        try:
            worlds.load(spec)
        except (ValueError, OSError) as problem:
            self._say(str(problem))
            return
        self._cancel.publish(GoalID())
        publish(self._say, self._world, String(spec))

    def reset(self) -> bool:
        """Put the robot back to the start. Returns whether it stands there."""
        self._cancel.publish(GoalID())
        return call(self._say, "sim_bridge/reset", Empty)
