"""The viewer's scene: world, robot, scan, costmaps, plans, trajectories, trail and goal, in the frame of the odometry.

With a map everything is drawn in the map's frame. Places [m]; the ground is z = 0.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.angles import compose, transform_point, yaw_of
from applr_ros1.nodes.conversions import MessageError, check_scan, pose_of
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.robots import Robot

from .listening import Listener
from .shapes import Costmap, Lines, Model, colours, lifted, turned

PLAN, GOAL = "move_base/NavfnROS/plan", "move_base/current_goal"
COSTMAPS = ("local_costmap", "global_costmap")
OBSTACLES, MOVERS = "sim_bridge/obstacles", "sim_bridge/movers"
LAYERS = ("scan", "local costmap", "global costmap", "global plan", "trajectories", "trail", "ghosts")
HIDDEN = ("global costmap",)  # at first
TRAIL = 2000  # points
STEP = 0.03  # m between two of them
JUMP = 0.5  # m between two points that belong to different trajectories, or drives
ROBOT = (235, 180, 40)
SIDES = 20  # of a drawn cylinder


def topics(robot: Robot) -> Dict[str, Any]:
    """{topic: class} of what the scene shows of a robot."""
    planner = "move_base/" + namespace(robot.parameters().get("base_local_planner", LOCAL_PLANNERS[0]))
    found = {robot.topics.scan: LaserScan, PLAN: Path, GOAL: PoseStamped}
    found.update({OBSTACLES: MarkerArray, MOVERS: MarkerArray})
    found.update({planner + "/local_plan": Path, planner + "/trajectory_cloud": PointCloud2})
    for name in COSTMAPS:
        found["move_base/%s/costmap" % name] = OccupancyGrid
        found["move_base/%s/costmap_updates" % name] = OccupancyGridUpdate
    return found


class Scene:
    """Draws what the listener has heard, each time `draw` is called.

    Args:
        server: viser's.
        robot: Description of the robot.
        listener: Has the topics of `topics(robot)`.
        base: The robot's frame.
    """

    def __init__(self, server: Any, robot: Robot, listener: Listener, base: str):
        self.server, self._robot, self._listener, self._base = server, robot, listener, base
        self._chosen, self._cloud = list(topics(robot))[5:7]
        scene = server.scene
        scene.configure_default_lights(cast_shadow=False)  # shadows would halve the pictures a second without a GPU
        scene.add_grid(
            "/ground", 60.0, 60.0, cell_size=1.0, section_size=5.0, plane_opacity=1.0, position=(0, 0, -0.01)
        )
        self.pose, self.shown = None, {name: name not in HIDDEN for name in LAYERS}
        self._model = Model(scene, "/robot", robot, ROBOT, None)
        self._scan = scene.add_point_cloud("/scan", np.zeros((1, 3)), (220, 40, 40), point_size=0.03, visible=False)
        self._plan = Lines(scene, "/plan", (60, 120, 230), 0.03)
        self._chosen_line = Lines(scene, "/chosen", (20, 160, 60), 0.06)
        self._samples = Lines(scene, "/samples", (0, 0, 0), 0.008)
        self._trail_line = Lines(scene, "/trail", (0, 0, 0), 0.05)
        self._costmaps = {
            name: Costmap(scene, "/" + name, z, period) for name, z, period in zip(COSTMAPS, (0.006, 0.003), (0.5, 1.0))
        }
        self._goal = scene.add_icosphere("/goal", 0.12, color=(40, 170, 80), visible=False)
        self._movers, self._trail = None, []  # type: Any, List[Tuple[float, float, float]]
        self.world_place = None  # of the frame in which the obstacles were drawn

    def draw(self, speed: float) -> None:
        """Bring everything up to date; speed [m/s] colours the trail."""
        self.pose = self._listener.place(self._base)
        self._model.put(self.pose)
        for draw in (self._draw_world, self._draw_scan, self._draw_plans, self._draw_costmaps):
            draw()
        self._draw_trail(speed)

    def begin_trail(self) -> None:
        """A new drive: the trail begins anew."""
        self._trail = []

    def _draw_world(self) -> None:
        place = self._listener.place("world")
        if place is None:
            return
        message = self._listener.news(OBSTACLES)
        if message is not None:
            self._add_obstacles(message.markers)
        if place != self.world_place:  # where the robot began, once more
            self.world_place = place
            for name in ("/cylinders", "/boxes", "/movers"):
                handle = self.server.scene.get_handle_by_name(name)
                if handle is not None:
                    handle.position, handle.wxyz = (*place[:2], 0.0), turned(place[2])
        movers = self._listener.news(MOVERS)
        if movers is not None:
            centres = np.array([(m.pose.position.x, m.pose.position.y, 0.0) for m in movers.markers], np.float32)
            if self._movers is None or len(self._movers.batched_positions) != len(centres):
                self._movers = self._add_cylinders("/movers", movers.markers, (205, 102, 51))
            self._movers.batched_positions = centres

    def _add_obstacles(self, markers: Any) -> None:
        if self._movers is not None:
            self._movers.remove()
            self._movers = None
        there = [marker for marker in markers if marker.action == Marker.ADD]
        self._add_cylinders("/cylinders", [m for m in there if m.type == Marker.CYLINDER], (150, 155, 165))
        boxes = [m for m in there if m.type == Marker.CUBE]
        corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
        faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
        faces += [(1, 5, 7), (1, 7, 3), (0, 2, 6), (0, 6, 4)]
        self._batch("/boxes", boxes, corners, np.array(faces), (158, 128, 90))

    def _add_cylinders(self, name: str, markers: List[Any], colour: Tuple[int, int, int]) -> Any:
        angles = np.arange(SIDES) * (2.0 * math.pi / SIDES)
        ring = np.column_stack([0.5 * np.cos(angles), 0.5 * np.sin(angles)])
        points = np.vstack([lifted(ring, 0.0), lifted(ring, 1.0), [(0.0, 0.0, 1.0)]])
        here, after = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
        top = np.full(SIDES, 2 * SIDES)
        side = np.column_stack([here, after, after + SIDES]), np.column_stack([here, after + SIDES, here + SIDES])
        faces = np.vstack([*side, np.column_stack([here + SIDES, after + SIDES, top])])
        return self._batch(name, markers, points, faces, colour)

    def _batch(self, name: str, markers: List[Any], points: np.ndarray, faces: np.ndarray, colour: Any) -> Any:
        """The same shape, of unit size, once for each marker."""
        old = self.server.scene.get_handle_by_name(name)
        if not markers:
            if old is not None:
                old.remove()
            return None
        place = self._listener.place("world") or (0.0, 0.0, 0.0)
        return self.server.scene.add_batched_meshes_simple(
            name,
            points,
            faces,
            np.array([turned(yaw_of(m.pose.orientation)) for m in markers]),
            np.array([(m.pose.position.x, m.pose.position.y, 0.0) for m in markers]),
            batched_scales=np.array([(m.scale.x, m.scale.y, m.scale.z) for m in markers]),
            batched_colors=colour,
            flat_shading=True,
            lod="off",
            position=(*place[:2], 0.0),
            wxyz=turned(place[2]),
        )

    def _draw_scan(self) -> None:
        message = self._listener.newest(self._robot.topics.scan)
        mounted = message and self._listener.place(message.header.frame_id)
        self._scan.visible = bool(mounted) and self.shown["scan"]
        if not self._scan.visible:
            return
        try:
            ranges = check_scan(message, None)
        except MessageError:
            return
        hits = np.flatnonzero((ranges >= message.range_min) & (ranges < message.range_max))
        angles = message.angle_min + hits * message.angle_increment
        flat = transform_point(mounted, ranges[hits] * np.cos(angles), ranges[hits] * np.sin(angles))
        self._scan.points = lifted(np.column_stack(flat), self._robot.laser.height)

    def _draw_plans(self) -> None:
        self._plan.shown, self._chosen_line.shown = self.shown["global plan"], self.shown["trajectories"]
        for topic, line, z in ((PLAN, self._plan, 0.02), (self._chosen, self._chosen_line, 0.04)):
            message = self._listener.news(topic)
            place = message and self._listener.place(message.header.frame_id)
            if place:
                points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.poses]).reshape(-1, 2)
                line.path(_moved(place, points), z)
        self._samples.shown = self.shown["trajectories"]
        message = self._listener.news(self._cloud)
        place = message and self._listener.place(message.header.frame_id)
        if place and message.width > 1:
            rows = np.frombuffer(message.data, "<f4").reshape(-1, message.point_step // 4)
            self._draw_samples(_moved(place, rows[:, :2].astype(np.float64)), rows[:, -1])
        message = self._listener.news(GOAL)
        place = message and self._listener.place(message.header.frame_id)
        if place:
            x, y, _ = compose(place, pose_of(message.pose))
            self._goal.position, self._goal.visible = (x, y, 0.12), True

    def _draw_samples(self, points: np.ndarray, costs: np.ndarray) -> None:
        """Trajectories, one after the other: points of the same cost that are near each other are joined."""
        joined = (costs[1:] == costs[:-1]) & (np.hypot(*(points[1:] - points[:-1]).T) < JUMP)
        low, high = np.percentile(costs, (0, 90))
        shades = colours((costs - low) / max(high - low, 1e-9))
        flat = lifted(points, 0.03)
        segments = np.stack([flat[:-1], flat[1:]], axis=1)[joined]
        self._samples.segments(segments, np.stack([shades[:-1], shades[1:]], axis=1)[joined])

    def _draw_costmaps(self) -> None:
        for name, costmap in self._costmaps.items():
            costmap.shown = self.shown[name.replace("_", " ")]
            topic = "move_base/%s/costmap" % name
            message = self._listener.news(topic)
            if message is not None:
                costmap.take(message)
            for update in self._listener.fresh(topic + "_updates"):
                costmap.update(update)
            if costmap.frame:
                costmap.draw(self._listener.place(costmap.frame))

    def _draw_trail(self, speed: float) -> None:
        if self.pose is None:
            return
        x, y, _ = self.pose
        moved = math.hypot(x - self._trail[-1][0], y - self._trail[-1][1]) if self._trail else math.inf
        if moved > JUMP:
            self._trail = []
        if moved > STEP:
            self._trail = [*self._trail[1 - TRAIL :], (x, y, speed)]
        self._trail_line.shown = self.shown["trail"]
        if moved > STEP or not self._trail_line.shown:
            rows = np.array(self._trail)
            self._trail_line.path(rows[:, :2], 0.015, colours(rows[:, 2] / self._robot.base.max_speed))

    def look(self, client: Any, from_above: bool) -> None:
        """Turn a page's camera to the robot: from above, or from behind."""
        x, y, yaw = self.pose or (0.0, 0.0, math.pi / 2)
        back = (1e-3, 14.0) if from_above else (3.5, 2.5)
        camera = client.camera
        camera.position = x - back[0] * math.cos(yaw), y - back[0] * math.sin(yaw), back[1]
        camera.look_at = (x, y, 0.0) if from_above else (x + math.cos(yaw), y + math.sin(yaw), 0.0)


def _moved(place: Any, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) of the frame at `place`, in the fixed frame."""
    return np.column_stack(transform_point(place, points[:, 0], points[:, 1]))
