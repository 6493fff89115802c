"""Gazebo services of the simulated robot (parameter ~gazebo of /sim_bridge), as called by the BARN Challenge.

The services are /gazebo/set_model_state, get_model_state, pause_physics and unpause_physics. The bridge itself provides
/collision and the controller's topic for velocity commands.

Unlike in Gazebo, set_model_state ignores the requested twist and leaves the robot at rest. All heights are 0.
"""

from __future__ import annotations

from math import cos, sin
from typing import Any

import rospy
from gazebo_msgs.srv import GetModelState, GetModelStateResponse, SetModelState, SetModelStateResponse
from std_srvs.srv import Empty

from applr_ros1.common.angles import yaw_of

from .ros_topics import quaternion

WORLD_FRAMES = ("", "world", "map", "/world", "/map")  # names of the world frame in requests


class GazeboInterface:
    """Gazebo services of one Bridge. They run in rospy's threads and take the bridge's lock."""

    def __init__(self, bridge: Any) -> None:
        self.bridge, self.robot = bridge, bridge.simulator.robot.name
        for name, kind, answer in (
            ("/gazebo/set_model_state", SetModelState, self.set_model_state),
            ("/gazebo/get_model_state", GetModelState, self.get_model_state),
            ("/gazebo/pause_physics", Empty, lambda _: bridge.pause() or []),
            ("/gazebo/unpause_physics", Empty, lambda _: bridge.unpause() or []),
        ):
            rospy.Service(name, kind, answer)

    def set_model_state(self, request: Any) -> SetModelStateResponse:
        """Place the robot at rest at the requested pose, while time goes on."""
        state, problem = request.model_state, ""
        if state.model_name != self.robot:
            problem = f"SetModelState: model [{state.model_name}] does not exist; give {self.robot}"
        elif state.reference_frame not in WORLD_FRAMES:
            problem = f"SetModelState: reference frame [{state.reference_frame}] is unknown; give world"
        if problem:
            rospy.logwarn("sim_bridge: %s", problem)
            return SetModelStateResponse(False, problem)
        position = state.pose.position
        self.bridge.teleport((position.x, position.y, yaw_of(state.pose.orientation)))
        return SetModelStateResponse(True, "SetModelState: set model state done")

    def get_model_state(self, request: Any) -> GetModelStateResponse:
        """Return pose and twist of the robot in the world frame."""
        with self.bridge.lock:
            state, stamp = self.bridge.simulator.state, self.bridge.stamp()
        answer = GetModelStateResponse()
        answer.header.stamp, answer.header.frame_id = stamp, request.relative_entity_name or "world"
        if request.relative_entity_name not in WORLD_FRAMES:
            name = request.relative_entity_name
            answer.status_message = f"GetModelState: reference relative_entity_name [{name}] not found; give world"
        elif request.model_name != self.robot:
            answer.status_message = f"GetModelState: model [{request.model_name}] does not exist"
        else:
            position, (x, y, yaw), (v, w) = answer.pose.position, state.pose, state.twist
            position.x, position.y, answer.pose.orientation = x, y, quaternion(yaw)
            answer.twist.linear.x, answer.twist.linear.y, answer.twist.angular.z = v * cos(yaw), v * sin(yaw), w
            answer.success, answer.status_message = True, "GetModelState: got properties"
        return answer
