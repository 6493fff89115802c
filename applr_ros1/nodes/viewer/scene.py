"""The viewer's scene: world, robot, scan, costmaps, plans, trajectories and goal.

Everything is drawn in the odometry frame, or in the map frame if there is a map. Positions are in
[m], and the ground is z = 0.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.angles import Pose, compose, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.messages import pose_of
from applr_ros1.common.pages.colors import rgb
from applr_ros1.common.paths import step_lengths
from applr_ros1.common.scan import distances_of
from applr_ros1.nodes.conversions import path_points
from applr_ros1.robots import Robot

from .listening import Listener
from .shapes import DrawnCostmap, Lines, Model, colours, lifted, pairs, put

PLAN = "move_base/NavfnROS/plan"
GOAL = "move_base/current_goal"
# Topics below the local planner's name
CHOSEN = "/local_plan"
SAMPLES = "/trajectory_cloud"
COSTMAPS = {
    "local costmap": "move_base/local_costmap/costmap",
    "global costmap": "move_base/global_costmap/costmap",
}
# Topics of the simulator's obstacles, with the colours of their cylinders
OBSTACLES = {"sim_bridge/obstacles": rgb("obstacle"), "sim_bridge/movers": rgb("mover")}
LAYERS = ("scan", *COSTMAPS, "global plan", "trajectories")
HIDDEN = ("global costmap",)  # layers that are hidden at the start
JUMP_M = 0.5  # distance between successive points above which a new trajectory begins [m]
SIDES = 20  # number of sides of a drawn cylinder
# Camera for the Jackal: distance behind the robot, height, distance of its target ahead [m]
VIEW = (3.5, 2.5, 1.0)
SIGHT_M = 0.1  # tolerance of a reported line of sight [m]


class ViewerScene:
    """3D scene of the latest messages, updated by `draw`. base: Base frame of the robot.

    Attributes:
        pose: Pose (x, y, yaw) of the robot, or None if it is unknown.
        layers: viser frame of each layer by name (LAYERS). Hiding a frame hides the layer.
    """

    def __init__(self, server: Any, robot: Robot, listener: Listener, base: str):
        from trimesh import creation

        self._robot = robot
        self._listener = listener
        self._base = base
        self._planner = "move_base/" + robot.local_planner
        scene = server.scene
        self._scene = scene
        # Without a GPU, shadows and environment lighting would cost two thirds of the frame rate.
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=0.8)
        scene.add_grid(
            "/ground",
            60.0,
            60.0,
            cell_size=1.0,
            section_size=5.0,
            cell_color=rgb("line"),
            cell_thickness=0.5,
            section_color=rgb("line"),
            position=(0.0, 0.0, -0.01),  # below everything that is drawn on the ground
        )
        self.layers = {}
        for layer_name in LAYERS:
            is_visible = layer_name not in HIDDEN
            layer = scene.add_frame(f"/{layer_name}", show_axes=False, visible=is_visible)
            self.layers[layer_name] = layer
        self._model = Model(scene, "/robot", robot, rgb("brand"))
        self._world = scene.add_frame("/world", show_axes=False)
        hidden_point = np.zeros((1, 3))
        self.scan = scene.add_point_cloud(
            "/scan/points", hidden_point, rgb("slow"), point_size=0.03, visible=False
        )
        self._plan = Lines(scene, "/global plan/line", rgb("line"), 0.03)
        self._chosen = Lines(scene, "/trajectories/chosen", rgb("goal"), 0.06)
        self._samples = Lines(scene, "/trajectories/samples", (0, 0, 0), 0.008)
        # The local costmap lies above the global one.
        self._costmaps = {}
        for costmap_name, z in zip(COSTMAPS, (0.006, 0.003)):
            self._costmaps[costmap_name] = DrawnCostmap(scene, f"/{costmap_name}/image", z)
        self._goal = scene.add_icosphere("/goal", 0.12, color=rgb("goal"), visible=False)
        self._of_goal = (self._plan.handle, self._chosen.handle, self._samples.handle, self._goal)
        self.pose: Any = None
        self._meshes = {
            Marker.CYLINDER: creation.cylinder(0.5, 1.0, sections=SIDES),
            Marker.CUBE: creation.box(),
        }
        self._standing: Dict[str, Any] = {}  # viser's handles of obstacles by name
        self._views: Dict[int, CameraView] = {}  # by client ID

    def draw(self, driving: bool) -> None:
        """Update everything. driving: Whether goal and plans are valid."""
        self.pose = self._listener.frame_pose(self._base)
        self._model.put(self.pose)
        self._draw_world()
        self._draw_scan()
        self._draw_plans()
        self._draw_samples()
        self._draw_costmaps()
        if not driving:
            for handle in self._of_goal:
                handle.visible = False

    def forget(self) -> None:
        """Hide old data after the clock jumped back, and reset the cameras to the robot."""
        for view in self._views.values():
            view.restart()
        self.scan.visible = False
        for handle in self._of_goal:
            handle.visible = False
        for costmap in self._costmaps.values():
            costmap.handle.visible = False

    def _draw_world(self) -> None:
        """Draw the simulator's obstacles. A robot has no frame `world`."""
        world_pose = self._listener.frame_pose("world")
        if world_pose is None:
            return
        # The world moves in the odometry frame when the robot is reset.
        put(self._world, world_pose)
        for topic, colour in OBSTACLES.items():
            message = self._listener.news(topic, MarkerArray)
            if message is None:
                continue
            markers = [marker for marker in message.markers if marker.action == Marker.ADD]
            for kind in self._meshes:
                markers_of_kind = [marker for marker in markers if marker.type == kind]
                self._draw_markers(f"/world/{topic}/{kind}", kind, markers_of_kind, colour)

    def _draw_markers(
        self, name: str, kind: int, markers: List[Any], colour: Tuple[int, int, int]
    ) -> None:
        """Draw the markers of one kind as scaled copies of a unit shape."""
        positions = np.zeros((len(markers), 3), np.float32)
        quaternions = np.zeros((len(markers), 4), np.float32)  # w first, as viser has them
        scales = np.zeros((len(markers), 3), np.float32)
        for i, marker in enumerate(markers):
            position = marker.pose.position
            rotation = marker.pose.orientation
            positions[i] = (position.x, position.y, position.z)
            quaternions[i] = (rotation.w, rotation.x, rotation.y, rotation.z)
            scales[i] = (marker.scale.x, marker.scale.y, marker.scale.z)

        # The same shapes only move. Others need a new mesh.
        handle = self._standing.get(name)
        if handle is not None and np.array_equal(handle.batched_scales, scales):
            handle.batched_positions = positions
            handle.batched_wxyzs = quaternions
            return
        if handle is not None:
            self._standing.pop(name).remove()
        if markers:
            mesh = self._meshes[kind]
            self._standing[name] = self._scene.add_batched_meshes_simple(
                name,
                mesh.vertices,
                mesh.faces,
                quaternions,
                positions,
                batched_scales=scales,
                batched_colors=colour,
                flat_shading=True,
                lod="off",
            )

    def _draw_scan(self) -> None:
        message, laser_pose = self._listener.placed(self._robot.topics.scan, LaserScan)
        if message is None:
            return
        ranges = distances_of(message.ranges, message.range_min, message.range_max)
        hit_beams = np.flatnonzero(np.isfinite(ranges))
        angles = message.angle_min + hit_beams * message.angle_increment
        x = ranges[hit_beams] * np.cos(angles)
        y = ranges[hit_beams] * np.sin(angles)
        points = _moved(laser_pose, np.column_stack([x, y]))
        self.scan.points = lifted(points, self._robot.laser.height)
        self.scan.visible = len(hit_beams) > 0

    def _draw_plans(self) -> None:
        # The chosen trajectory lies above the plan that it follows.
        self._draw_path(PLAN, self._plan, 0.02)
        self._draw_path(self._planner + CHOSEN, self._chosen, 0.04)
        message, frame_pose = self._listener.placed(GOAL, PoseStamped)
        if message is not None:
            goal_x, goal_y, _ = compose(frame_pose, pose_of(message.pose))
            self._goal.position = (goal_x, goal_y, 0.12)
            self._goal.visible = True

    def _draw_path(self, topic: str, line: Lines, z: float) -> None:
        """Draw the latest nav_msgs/Path of a topic at height z [m]."""
        message, frame_pose = self._listener.placed(topic, Path)
        if message is None:
            return
        line.path(_moved(frame_pose, path_points(message.poses)), z)

    def _draw_samples(self) -> None:
        """Draw the trajectories of the local planner's samples."""
        message, frame_pose = self._listener.placed(self._planner + SAMPLES, PointCloud2)
        if message is None or message.width < 2:
            return
        rows = np.frombuffer(message.data, "<f4").reshape(-1, message.point_step // 4)
        positions = rows[:, :2].astype(np.float64)
        places = _moved(frame_pose, positions)
        points = lifted(places, 0.03)
        costs = rows[:, -1]

        # The cloud has no numbers of trajectories. Points of one have the same cost and are close.
        is_near = step_lengths(places) < JUMP_M
        is_joined = (costs[1:] == costs[:-1]) & is_near

        # The highest costs would leave the others without a difference of colour.
        lowest_cost, high_cost = np.percentile(costs, (0, 90))
        cost_span = max(high_cost - lowest_cost, 1e-9)
        shades = colours((costs - lowest_cost) / cost_span)
        self._samples.segments(pairs(points)[is_joined], pairs(shades)[is_joined])

    def _draw_costmaps(self) -> None:
        for costmap_name, costmap in self._costmaps.items():
            topic = COSTMAPS[costmap_name]
            # A hidden costmap takes its messages, too, so that it is complete once it is shown.
            message = self._listener.news(topic, OccupancyGrid)
            if message is not None:
                costmap.replace_map(message)
            for update in self._listener.fresh(topic + "_updates", OccupancyGridUpdate):
                costmap.patch_map(update)
            if self.layers[costmap_name].visible:
                costmap.draw(self._listener)

    def follow(self, client: Any) -> None:
        """Move a client's camera with the robot. The camera starts behind the robot."""
        if self.pose is None:
            return
        view = self._views.get(client.client_id)
        if view is None:
            view = self._views[client.client_id] = CameraView(self._robot.world_scale)
            client.camera.on_update(view.take_report)
        view.follow(client.camera, self.pose)


class CameraView:
    """Camera of one client, which starts behind the robot and follows it.

    Args:
        scale: Size of the robot relative to the Jackal (Robot.world_scale).
    """

    def __init__(self, scale: float):
        self._distance_behind, self._height, self._distance_ahead = np.multiply(scale, VIEW)
        self.restart()

    def restart(self) -> None:
        """Place the camera behind the robot again."""
        self._is_placed = False  # whether the client has reported the camera there
        self._yaw: Optional[float] = None  # direction in which the camera is placed [rad]

    def follow(self, camera: Any, robot_pose: Pose) -> None:
        """Move the camera with the robot, or place it behind the robot."""
        x, y, yaw = robot_pose
        if self._yaw is None:
            self._yaw = yaw
        target_x = x + self._distance_ahead * math.cos(self._yaw)
        target_y = y + self._distance_ahead * math.sin(self._yaw)
        if self._is_placed:
            # The user may have turned or moved the camera: only the robot's motion is added.
            moved_x = target_x - camera.look_at[0]
            moved_y = target_y - camera.look_at[1]
            camera.position = camera.position + (moved_x, moved_y, 0.0)
        else:
            camera.position = (target_x, target_y, 0.0) - self._line_of_sight(self._yaw)
            camera.look_at = (target_x, target_y, 0.0)

    async def take_report(self, camera: Any) -> None:
        """Take the camera's pose from its client.

        While a page opens, it reports its own first pose several times, also after it was told
        another one. The camera is told again until the client reports it.
        """
        if self._yaw is None:
            return
        # viser runs a coroutine at once, before the camera's pose is replaced.
        line_of_sight = camera.look_at - camera.position
        if np.allclose(line_of_sight, self._line_of_sight(self._yaw), atol=SIGHT_M):
            self._is_placed = True

    def _line_of_sight(self, yaw: float) -> Array:
        """Return the way (3,) from the camera to its target [m], if it was placed at `yaw`."""
        distance = self._distance_behind + self._distance_ahead
        return np.array([distance * math.cos(yaw), distance * math.sin(yaw), -self._height])


def _moved(place: Any, points: Array) -> Array:
    """Transform points (n, 2) from the frame at `place` to the fixed frame."""
    return np.column_stack(transform_point(place, points[:, 0], points[:, 1]))
