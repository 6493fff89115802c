"""Changes during a drive, for a person who plays with the robot: time is stopped or slower, moving obstacles go.

Topic of /sim_bridge: ~real_time_factor (std_msgs/Float64, as the parameter). Services: ~pause (std_srvs/SetBool), ~step
(std_srvs/Trigger: one control period while it is paused), ~let_move (std_srvs/SetBool: false takes the moving obstacles
away, true brings them back).
"""

from __future__ import annotations

import dataclasses
from math import isfinite
from typing import Any

import rospy
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

SINGLE_STEP_TICKS = 5  # ticks of 0.01 s: one control period


class Changes:
    """The topics and services for one Bridge. They run in rospy's threads and take the bridge's lock."""

    def __init__(self, bridge: Any):
        self._bridge = bridge
        self._course, self._movers = None, ()  # of the world whose moving obstacles were taken away
        rospy.Subscriber("~real_time_factor", Float64, self._set_factor, queue_size=1)
        rospy.Service("~pause", SetBool, self._pause)
        rospy.Service("~step", Trigger, self._step)
        rospy.Service("~let_move", SetBool, self._let_move)

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
        self._bridge.single_ticks += SINGLE_STEP_TICKS
        return TriggerResponse(True, "one control period")
