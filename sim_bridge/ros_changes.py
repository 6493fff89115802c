"""Changes during a drive, for a person who plays with the robot: obstacles come and go, and time is stopped or slower.

Topics of /sim_bridge: ~change_obstacle (visualization_msgs/Marker in the frame world: ADD stands a cylinder of the
diameter scale.x at pose.position, DELETE takes the static obstacles there away), ~real_time_factor (std_msgs/Float64,
as the parameter). Services: ~pause (std_srvs/SetBool), ~step (std_srvs/Trigger: one control period while it is
paused), ~let_move (std_srvs/SetBool: false takes the moving obstacles away, true brings them back).
"""

from __future__ import annotations

import dataclasses
from math import hypot, isfinite
from typing import Any

import numpy as np
import rospy
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse
from visualization_msgs.msg import Marker

from applr_ros1.common import angles
from applr_ros1.robots import geometry

from .ros_topics import WORLD

SINGLE_STEP = 5  # ticks of 0.01 s: one control period
REACH = 0.1  # m from an obstacle at which it still counts as meant
RADII = 0.02, 2.0  # m, of a cylinder
MOST = 2000  # static obstacles


class Changes:
    """The topics and services for one Bridge. They run in rospy's threads and take the bridge's lock."""

    def __init__(self, bridge: Any):
        self._bridge = bridge
        self._course, self._movers = None, ()  # of the world whose moving obstacles were taken away
        rospy.Subscriber("~change_obstacle", Marker, self._change, queue_size=10)
        rospy.Subscriber("~real_time_factor", Float64, self._set_factor, queue_size=1)
        rospy.Service("~pause", SetBool, self._pause)
        rospy.Service("~step", Trigger, self._step)
        rospy.Service("~let_move", SetBool, self._let_move)

    def _change(self, message: Marker) -> None:
        x, y, radius = message.pose.position.x, message.pose.position.y, 0.5 * message.scale.x
        frame, add = message.header.frame_id.lstrip("/"), message.action == Marker.ADD
        with self._bridge.lock:
            world = self._bridge.simulator.world
            problem = f"it is given in the frame {frame}: give it in {WORLD}" if frame not in ("", WORLD) else ""
            if not problem and not (isfinite(x) and isfinite(y)):
                problem = "its place is not finite"
            elif not problem and add:
                problem = self._no_room(x, y, radius, len(world.cylinders) + len(world.boxes))
            if problem:
                rospy.logwarn("sim_bridge: obstacle not changed: %s", problem)
                return
            if add:
                cylinders, boxes = np.vstack([world.cylinders, (x, y, radius)]), world.boxes
            else:
                cylinders, boxes = _without(world, x, y)
            self._stand(dataclasses.replace(world, cylinders=cylinders, boxes=boxes))

    def _no_room(self, x: float, y: float, radius: float, others: int) -> str:
        """Why a cylinder cannot stand there; "" if it can."""
        if not RADII[0] <= radius <= RADII[1]:
            return f"its scale.x is {2 * radius:g}: give a diameter from {2 * RADII[0]:g} to {2 * RADII[1]:g} m"
        if others >= MOST:
            return f"{others} obstacles stand here, more than that are not taken"
        simulator = self._bridge.simulator
        back, front, right, left = geometry.bounding_box(simulator.robot)
        at_x, at_y = angles.transform_point(angles.inverse(simulator.state.pose), x, y)
        near = hypot(at_x - min(max(at_x, back), front), at_y - min(max(at_y, right), left)) <= radius
        return "it would touch the robot" if near else ""

    def _stand(self, world: Any) -> None:
        bridge = self._bridge
        bridge.simulator.change_obstacles(world)
        bridge.topics.publish_obstacles(bridge.simulator, bridge.stamp())

    def _let_move(self, request: Any) -> SetBoolResponse:
        with self._bridge.lock:
            world = self._bridge.simulator.world
            if request.data and world.course is self._course:
                self._course = None
                self._stand(dataclasses.replace(world, movers=self._movers))
            elif not request.data and world.movers:
                self._course, self._movers = world.course, world.movers
                self._stand(dataclasses.replace(world, movers=()))
            count = len(self._bridge.simulator.world.movers)
        return SetBoolResponse(True, f"{count} moving obstacles")

    def _set_factor(self, message: Float64) -> None:
        if isfinite(message.data) and 0.0 <= message.data <= 1e6:
            self._bridge.factor = message.data
        else:
            rospy.logwarn("sim_bridge: real_time_factor stays: %g is no number from 0 to 1e6", message.data)

    def _pause(self, request: Any) -> SetBoolResponse:
        (self._bridge.pause if request.data else self._bridge.unpause)()
        return SetBoolResponse(True, "time stands" if request.data else "time goes on")

    def _step(self, _: Any) -> TriggerResponse:
        if self._bridge.running.is_set():
            return TriggerResponse(False, "time goes on: pause it first")
        self._bridge.single_ticks += SINGLE_STEP
        return TriggerResponse(True, "one control period")


def _without(world: Any, x: float, y: float) -> Any:
    """The cylinders and boxes of a world but for those at (x, y)."""
    circles, boxes = world.cylinders, world.boxes
    clear = np.hypot(circles[:, 0] - x, circles[:, 1] - y) > circles[:, 2] + REACH
    outside = [hypot(*angles.outside_box(x - b[0], y - b[1], *b[2:])) > REACH for b in boxes]
    return circles[clear], boxes[np.array(outside, bool)]
