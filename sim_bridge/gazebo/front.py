"""Services and topics of Gazebo and of its Jackal on the bridge's simulated robot (parameter ~gazebo of /sim_bridge).

Services: /gazebo/set_model_state, get_model_state, get_world_properties, pause_physics, unpause_physics, reset_world,
reset_simulation, and robot_localization's /set_pose.
Topics: /gazebo/model_states, /gazebo/link_states (of the base only), and /jackal_velocity_controller/cmd_vel, on which
every command on /cmd_vel is repeated as twist_mux does. /collision comes from the bridge itself.

What differs from Gazebo: /clock does not go back at reset_simulation; a requested twist is not taken over, the robot
stands after set_model_state; heights are 0.
"""

from __future__ import annotations

from typing import Any, List, Tuple

import rospy
from gazebo_msgs.msg import LinkStates, ModelStates
from gazebo_msgs.srv import (
    GetModelState,
    GetModelStateResponse,
    GetWorldProperties,
    GetWorldPropertiesResponse,
    SetModelState,
    SetModelStateResponse,
)
from geometry_msgs.msg import Pose, Twist
from robot_localization.srv import SetPose, SetPoseResponse
from std_srvs.srv import Empty, EmptyResponse

from .messages import planar, pose_message, twist_message

CONTROLLER = "/jackal_velocity_controller/cmd_vel"
WORLD_FRAMES = ("", "world", "map", "/world", "/map")  # of requests: all mean the world
BASE_LINK = "base_link"


class Front:
    """Gazebo's interface of one Bridge. Its services run in rospy's threads and take the bridge's lock."""

    def __init__(self, bridge: Any):
        self.bridge = bridge
        self.robot = str(rospy.get_param("~robot_name", "jackal"))
        self._models = rospy.Publisher("/gazebo/model_states", ModelStates, queue_size=10)
        self._links = rospy.Publisher("/gazebo/link_states", LinkStates, queue_size=10)
        self._controller = rospy.Publisher(CONTROLLER, Twist, queue_size=10, tcp_nodelay=True)
        for name, kind, answer in (
            ("/gazebo/set_model_state", SetModelState, self.set_model_state),
            ("/gazebo/get_model_state", GetModelState, self.get_model_state),
            ("/gazebo/get_world_properties", GetWorldProperties, self.get_world_properties),
            ("/gazebo/pause_physics", Empty, self.pause),
            ("/gazebo/unpause_physics", Empty, self.unpause),
            ("/gazebo/reset_world", Empty, self.reset_world),
            ("/gazebo/reset_simulation", Empty, self.reset_simulation),
            ("/set_pose", SetPose, self.set_pose),
        ):
            rospy.Service(name, kind, answer)

    # -- velocity commands -------------------------------------------------------------------------
    def on_cmd_vel(self, message: Any) -> None:
        """A command on /cmd_vel: pass it to the controller, as twist_mux does."""
        self.bridge.on_command(message)
        self._controller.publish(message)

    def on_controller_command(self, message: Any) -> None:
        """A command on the controller's own topic; those that on_cmd_vel repeats there count already."""
        if message._connection_header.get("callerid") != rospy.get_name():
            self.bridge.on_command(message)

    # -- services ----------------------------------------------------------------------------------
    def set_model_state(self, request: Any) -> SetModelStateResponse:
        """Put the robot somewhere else; it stands then, and time goes on."""
        state = request.model_state
        pose = planar(state.pose)
        problem = ""
        if state.model_name != self.robot:
            problem = "SetModelState: model [%s] does not exist; it is called %s" % (state.model_name, self.robot)
        elif state.reference_frame not in WORLD_FRAMES:
            problem = "SetModelState: reference frame [%s] is not known; give world" % state.reference_frame
        elif pose is None:
            problem = "SetModelState: the pose must be finite"
        if problem:
            rospy.logwarn("sim_bridge: %s", problem)
            return SetModelStateResponse(False, problem)
        self.bridge.teleport(pose)
        return SetModelStateResponse(True, "SetModelState: set model state done")

    def get_model_state(self, request: Any) -> GetModelStateResponse:
        """Pose and twist of the robot or of a moving obstacle in the world."""
        with self.bridge.lock:
            models, stamp = self._states(), self.bridge.stamp()
        answer = GetModelStateResponse()
        answer.header.stamp, answer.header.frame_id = stamp, request.relative_entity_name or "world"
        if request.relative_entity_name not in WORLD_FRAMES:
            answer.status_message = (
                "GetModelState: reference relative_entity_name [%s] not found; give world"
                % request.relative_entity_name
            )
            return answer
        for name, pose, twist in models:
            if name == request.model_name:
                answer.pose, answer.twist, answer.success = pose, twist, True
                answer.status_message = "GetModelState: got properties"
                return answer
        answer.status_message = "GetModelState: model [%s] does not exist" % request.model_name
        return answer

    def get_world_properties(self, _: Any) -> GetWorldPropertiesResponse:
        """Simulated time and the names of the models."""
        with self.bridge.lock:
            names, stamp = [name for name, _, _ in self._states()], self.bridge.stamp()
        return GetWorldPropertiesResponse(stamp.to_sec(), names, False, True, "GetWorldProperties: got properties")

    def pause(self, _: Any) -> EmptyResponse:
        """Stop simulated time."""
        self.bridge.pause()
        return EmptyResponse()

    def unpause(self, _: Any) -> EmptyResponse:
        """Let simulated time go on."""
        self.bridge.unpause()
        return EmptyResponse()

    def reset_world(self, _: Any) -> EmptyResponse:
        """The robot back to where it started; time and moving obstacles go on."""
        self.bridge.teleport(self.bridge.start_pose())
        return EmptyResponse()

    def reset_simulation(self, _: Any) -> EmptyResponse:
        """Robot, odometry and moving obstacles back to the start. ROS time goes on: it never goes back here."""
        self.bridge.restart()
        return EmptyResponse()

    def set_pose(self, request: Any) -> SetPoseResponse:
        """Set the position that the odometry states. Its heading comes from the IMU again at once, as on the Jackal."""
        pose = planar(request.pose.pose.pose)
        if pose is None:
            raise rospy.ServiceException("/set_pose: the pose must be finite")
        self.bridge.set_position(pose[0], pose[1])
        return SetPoseResponse()

    # -- topics ------------------------------------------------------------------------------------
    def publish(self) -> None:
        """States of all models, where somebody listens; called with the bridge's lock held."""
        if self._models.get_num_connections():
            names, poses, twists = (list(column) for column in zip(*self._states()))
            self._models.publish(ModelStates(names, poses, twists))
        if self._links.get_num_connections():
            state = self.bridge.simulator.state
            link = "%s::%s" % (self.robot, BASE_LINK)
            self._links.publish(
                LinkStates([link], [pose_message(state.pose)], [twist_message(state.pose[2], state.twist)])
            )

    def _states(self) -> List[Tuple[str, Pose, Twist]]:
        """Name, pose and twist of ground, moving obstacles and robot."""
        simulator = self.bridge.simulator
        models = [("ground_plane", pose_message((0.0, 0.0, 0.0)), Twist())]
        for n, (x, y, _) in enumerate(simulator.mover_circles().tolist()):
            models.append(("mover_%d" % n, pose_message((x, y, 0.0)), Twist()))
        state = simulator.state
        models.append((self.robot, pose_message(state.pose), twist_message(state.pose[2], state.twist)))
        return models
