"""Gazebo services of the simulated robot, as called by the BARN Challenge.

The parameter ~gazebo of /sim_bridge offers them. The services are /gazebo/set_model_state,
get_model_state, pause_physics and unpause_physics. The bridge itself provides /collision and the
controller's topic for velocity commands.

Unlike in Gazebo, set_model_state ignores the requested twist and leaves the robot at rest. All
heights are 0.
"""

from __future__ import annotations

from math import cos, sin
from typing import Any

import rospy
from gazebo_msgs.srv import (
    GetModelState,
    GetModelStateResponse,
    SetModelState,
    SetModelStateResponse,
)
from std_srvs.srv import Empty

from applr_ros1.common.angles import yaw_of

from .ros_topics import quaternion

WORLD_FRAMES = ("", "world", "map", "/world", "/map")  # names of the world frame in requests


class GazeboInterface:
    """Gazebo services of one Bridge. They run in rospy's threads and take the bridge's lock."""

    def __init__(self, bridge: Any) -> None:
        self.bridge = bridge
        self.robot = bridge.simulator.robot.name
        rospy.Service("/gazebo/set_model_state", SetModelState, self.set_model_state)
        rospy.Service("/gazebo/get_model_state", GetModelState, self.get_model_state)
        rospy.Service("/gazebo/pause_physics", Empty, bridge.pause)
        rospy.Service("/gazebo/unpause_physics", Empty, bridge.unpause)

    def set_model_state(self, request: Any) -> SetModelStateResponse:
        """Place the robot at rest at the requested pose, while time goes on."""
        state = request.model_state
        # The texts are Gazebo's, with what to give instead.
        problem = ""
        if state.model_name != self.robot:
            problem = f"model [{state.model_name}] does not exist; give {self.robot}"
        elif state.reference_frame not in WORLD_FRAMES:
            problem = f"reference frame [{state.reference_frame}] is unknown; give world"
        if problem:
            problem = "SetModelState: " + problem
            rospy.logwarn("sim_bridge: %s", problem)
            return SetModelStateResponse(False, problem)
        position = state.pose.position
        self.bridge.teleport((position.x, position.y, yaw_of(state.pose.orientation)))
        return SetModelStateResponse(True, "SetModelState: set model state done")

    def get_model_state(self, request: Any) -> GetModelStateResponse:
        """Return pose and twist of the robot in the world frame."""
        with self.bridge.lock:
            state = self.bridge.simulator.state
            stamp = self.bridge.stamp()
        frame_name = request.relative_entity_name
        answer = GetModelStateResponse()
        answer.header.stamp = stamp
        answer.header.frame_id = frame_name or "world"
        if frame_name not in WORLD_FRAMES:
            problem = f"reference relative_entity_name [{frame_name}] not found; give world"
            answer.status_message = "GetModelState: " + problem
            return answer
        if request.model_name != self.robot:
            answer.status_message = f"GetModelState: model [{request.model_name}] does not exist"
            return answer
        # Gazebo's twist is in the world frame, that of the simulator in the body frame.
        x, y, yaw = state.pose
        v, w = state.twist
        answer.pose.position.x = x
        answer.pose.position.y = y
        answer.pose.orientation = quaternion(yaw)
        answer.twist.linear.x = v * cos(yaw)
        answer.twist.linear.y = v * sin(yaw)
        answer.twist.angular.z = w
        answer.success = True
        answer.status_message = "GetModelState: got properties"
        return answer
