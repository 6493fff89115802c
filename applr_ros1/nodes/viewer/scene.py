"""The viewer's scene: world, robot, scan, costmaps, plans, trajectories and goal.

Everything is drawn in the odometry frame, or in the map frame if there is a map. Positions are in [m], and the ground
is z = 0.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Dict, List, Tuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.angles import compose, transform_point
from applr_ros1.nodes.conversions import pose_of
from applr_ros1.robots import Robot

from .listening import Listener
from .shapes import Costmap, Lines, Model, colours, lifted, put

PLAN, GOAL = "move_base/NavfnROS/plan", "move_base/current_goal"
CHOSEN, SAMPLES = "/local_plan", "/trajectory_cloud"  # topics below the local planner's name
COSTMAPS = {
    "local costmap": "move_base/local_costmap/costmap",
    "global costmap": "move_base/global_costmap/costmap",
}
OBSTACLES, MOVERS = "sim_bridge/obstacles", "sim_bridge/movers"
LAYERS = ("scan", *COSTMAPS, "global plan", "trajectories")
HIDDEN = ("global costmap",)  # layers that are hidden at the start
JUMP_M = 0.5  # distance between successive points above which a new trajectory begins [m]
ROBOT, CYLINDER, BOX, MOVER = (235, 180, 40), (150, 155, 165), (158, 128, 90), (205, 102, 51)
SIDES = 20  # number of sides of a drawn cylinder
VIEW = (
    3.5,
    2.5,
    1.0,
)  # camera for the Jackal: distance behind, height, distance of its target ahead of the robot [m]


class Scene:
    """3D scene of the latest messages, updated by `draw`. base: Base frame of the robot.

    Attributes:
        pose: Pose (x, y, yaw) of the robot, or None if it is unknown.
        layers: viser frame of each layer by name (LAYERS). Hiding a frame hides the layer.
    """

    def __init__(self, server: Any, robot: Robot, listener: Listener, base: str):
        from trimesh import creation

        self._robot, self._listener, self._base = robot, listener, base
        self._planner = "move_base/" + robot.local_planner
        self._scene = scene = server.scene
        # Without a GPU, shadows and environment lighting would cost two thirds of the frame rate.
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=0.8)
        ground = {
            "cell_size": 1.0,
            "section_size": 5.0,
            "plane_opacity": 1.0,
            "position": (0, 0, -0.01),
        }
        scene.add_grid("/ground", 60.0, 60.0, **ground)
        layer = partial(scene.add_frame, show_axes=False)
        self.layers = {name: layer("/" + name, visible=name not in HIDDEN) for name in LAYERS}
        self._model = Model(scene, "/robot", robot, ROBOT)
        self._world = scene.add_frame("/world", show_axes=False)
        nothing = np.zeros((1, 3))
        self._scan = scene.add_point_cloud(
            "/scan/points", nothing, (220, 40, 40), point_size=0.03, visible=False
        )
        self._plan = Lines(scene, "/global plan/line", (60, 120, 230), 0.03)
        self._chosen = Lines(scene, "/trajectories/chosen", (20, 160, 60), 0.06)
        self._samples = Lines(scene, "/trajectories/samples", (0, 0, 0), 0.008)
        self._costmaps = {
            name: Costmap(scene, f"/{name}/image", z) for name, z in zip(COSTMAPS, (0.006, 0.003))
        }
        self._goal = scene.add_icosphere("/goal", 0.12, color=(40, 170, 80), visible=False)
        self._of_goal = (self._plan.handle, self._chosen.handle, self._samples.handle, self._goal)
        self.pose: Any = None
        self._meshes = {
            Marker.CYLINDER: creation.cylinder(0.5, 1.0, sections=SIDES),
            Marker.CUBE: creation.box(),
        }
        self._standing: Dict[str, Any] = {}  # viser's handles of obstacles by name
        self._aims: Dict[
            int, Tuple[float, float]
        ] = {}  # by client ID: camera target relative to the robot [m]

    def draw(self, driving: bool) -> None:
        """Update everything. driving: Whether goal and plans are valid."""
        self.pose = self._listener.frame_pose(self._base)
        self._model.put(self.pose)
        self._draw_world()
        self._draw_scan()
        self._draw_plans()
        self._draw_samples()
        self._draw_costmaps()
        for shown in () if driving else self._of_goal:
            shown.visible = False

    def forget(self) -> None:
        """Hide old data after the clock jumped back, and reset the cameras to the robot."""
        self._aims.clear()
        self._scan.visible = False
        for shown in (*self._of_goal, *(costmap.handle for costmap in self._costmaps.values())):
            shown.visible = False

    def _draw_world(self) -> None:
        place = self._listener.frame_pose("world")
        if place is None:
            return
        put(self._world, place)  # The world moves in the odometry frame when the robot is reset.
        for topic, cylinder in ((OBSTACLES, CYLINDER), (MOVERS, MOVER)):
            message = self._listener.news(topic, MarkerArray)
            for kind, colour in (
                ((Marker.CYLINDER, cylinder), (Marker.CUBE, BOX)) if message is not None else ()
            ):
                there = [m for m in message.markers if m.action == Marker.ADD and m.type == kind]
                self._stand(f"/world/{topic.split('/')[1]}/{kind}", kind, there, colour)

    def _stand(
        self, name: str, kind: int, markers: List[Any], colour: Tuple[int, int, int]
    ) -> None:
        """Draw the markers of one kind as scaled copies of a unit shape."""
        poses = [m.pose for m in markers]
        places = np.array([(p.position.x, p.position.y, p.position.z) for p in poses], np.float32)
        turns = np.array([(q.w, q.x, q.y, q.z) for q in (p.orientation for p in poses)], np.float32)
        sizes = np.array([(m.scale.x, m.scale.y, m.scale.z) for m in markers], np.float32)
        old = self._standing.get(name)
        if old is not None and np.array_equal(old.batched_scales, sizes):  # Only the poses change.
            old.batched_positions, old.batched_wxyzs = places, turns
            return
        if old is not None:
            self._standing.pop(name).remove()
        if markers:
            mesh = self._meshes[kind].vertices, self._meshes[kind].faces
            look = {
                "batched_scales": sizes,
                "batched_colors": colour,
                "flat_shading": True,
                "lod": "off",
            }
            self._standing[name] = self._scene.add_batched_meshes_simple(
                name, *mesh, turns, places, **look
            )

    def _draw_scan(self) -> None:
        message, mounted = self._listener.placed(self._robot.topics.scan, LaserScan)
        if message is None:
            return
        ranges = np.asarray(message.ranges)
        hits = np.flatnonzero((ranges >= message.range_min) & (ranges < message.range_max))
        angles = message.angle_min + hits * message.angle_increment
        flat = np.column_stack([ranges[hits] * np.cos(angles), ranges[hits] * np.sin(angles)])
        self._scan.points, self._scan.visible = (
            lifted(_moved(mounted, flat), self._robot.laser.height),
            len(hits) > 0,
        )

    def _draw_plans(self) -> None:
        for topic, line, z in (
            (PLAN, self._plan, 0.02),
            (self._planner + CHOSEN, self._chosen, 0.04),
        ):
            message, place = self._listener.placed(topic, Path)
            if message is not None:
                points = np.array(
                    [(p.pose.position.x, p.pose.position.y) for p in message.poses]
                ).reshape(-1, 2)
                line.path(_moved(place, points), z)
        message, place = self._listener.placed(GOAL, PoseStamped)
        if message is not None:
            x, y, _ = compose(place, pose_of(message.pose))
            self._goal.position, self._goal.visible = (x, y, 0.12), True

    def _draw_samples(self) -> None:
        """Draw the trajectories. Successive points with the same cost and a small distance are joined."""
        message, place = self._listener.placed(self._planner + SAMPLES, PointCloud2)
        if message is None or message.width < 2:
            return
        rows = np.frombuffer(message.data, "<f4").reshape(-1, message.point_step // 4)
        flat, costs = lifted(_moved(place, rows[:, :2].astype(np.float64)), 0.03), rows[:, -1]
        joined = (costs[1:] == costs[:-1]) & (np.hypot(*(flat[1:] - flat[:-1])[:, :2].T) < JUMP_M)
        low, high = np.percentile(costs, (0, 90))
        shades = colours((costs - low) / max(high - low, 1e-9))
        segments, shades = (
            np.stack([rows[:-1], rows[1:]], axis=1)[joined] for rows in (flat, shades)
        )
        self._samples.segments(segments, shades)

    def _draw_costmaps(self) -> None:
        for name, costmap in self._costmaps.items():
            message = self._listener.news(COSTMAPS[name], OccupancyGrid)
            if message is not None:
                costmap.take(message)
            for update in self._listener.fresh(COSTMAPS[name] + "_updates", OccupancyGridUpdate):
                costmap.update(update)
            if self.layers[name].visible:
                costmap.draw(self._listener)

    def follow(self, client: Any) -> None:
        """Move a client's camera with the robot. The camera starts behind the robot."""
        if self.pose is None:
            return
        x, y, yaw = self.pose
        if client.client_id in self._aims:
            aim = np.add((x, y), self._aims[client.client_id])
            client.camera.position = client.camera.position + (
                *(aim - client.camera.look_at[:2]),
                0.0,
            )
            return
        back, high, ahead = np.multiply(self._robot.world_scale, VIEW)
        aim = self._aims[client.client_id] = ahead * math.cos(yaw), ahead * math.sin(yaw)
        client.camera.position = x - back * math.cos(yaw), y - back * math.sin(yaw), high
        client.camera.look_at = x + aim[0], y + aim[1], 0.0


def _moved(place: Any, points: np.ndarray) -> np.ndarray:
    """Transform points (n, 2) from the frame at `place` to the fixed frame."""
    return np.column_stack(transform_point(place, points[:, 0], points[:, 1]))
