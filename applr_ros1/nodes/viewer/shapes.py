"""Elements of the viewer's scene: colours, lines, the robot's model, and costmaps as textures."""

from __future__ import annotations

import time
from typing import Any, Optional, Tuple

import numpy as np
from nav_msgs.msg import MapMetaData

from applr_ros1.common.angles import Pose, compose, quaternion_of
from applr_ros1.common.arrays import Array, Array32, Data
from applr_ros1.common.pages.colors import rgb
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import wheel_places

from .listening import Listener
from .look import CHEAP, DEAR

RUBBER = (40, 40, 45)  # colour of the wheels
BLACK = (20, 20, 25)  # colour of the laser
WHITE = (255, 255, 255)  # colour of the arrow to the front
ABOVE_M = 0.005  # height of the arrow above the body [m]
PICTURE_PERIOD_S = 0.5  # shortest wall time between two images of a costmap [s]


def colours(costs: Array) -> Data:
    """Return colours (n, 3) uint8 for costs (n,) from 0 to 1."""
    # Each channel goes from the cheap colour to the dear one with the cost.
    dear_share = np.clip(costs, 0.0, 1.0)[:, None]
    cheap_share = 1.0 - dear_share
    shades = cheap_share * rgb(CHEAP) + dear_share * rgb(DEAR)
    return shades.astype(np.uint8)


def lifted(points: Array, z: float) -> Array32:
    """Return points (n, 2) as (n, 3) float32 at height z [m]."""
    heights = np.full(len(points), z)
    return np.column_stack([points, heights]).astype(np.float32)


def pairs(rows: Data) -> Data:
    """Return rows (n, 3) as pairs of successive rows (n - 1, 2, 3)."""
    return np.stack([rows[:-1], rows[1:]], axis=1)


def put(handle: Any, pose: Pose, z: float = 0.0) -> None:
    """Move a handle to the pose (x, y, yaw) at height z [m]."""
    x, y, yaw = pose
    handle.position = (x, y, z)
    handle.wxyz = np.roll(quaternion_of(yaw), 1)  # viser's quaternions begin with w.


class Lines:
    """Line segments that can be updated."""

    def __init__(self, scene: Any, name: str, colour: Tuple[int, int, int], thickness: float):
        self._colour = np.array(colour, np.uint8)
        # viser refuses empty arrays, so that lines without points are hidden.
        hidden_segment = np.zeros((1, 2, 3))
        hidden_shades = hidden_segment.astype(np.uint8)
        self.handle = scene.add_line_segments(
            name, hidden_segment, hidden_shades, thickness=thickness, visible=False
        )

    def path(self, points: Array, z: float) -> None:
        """Draw a line through points (n, 2) at height z [m]."""
        self.segments(pairs(lifted(points, z)))

    def segments(self, points: Array32, shades: Optional[Data] = None) -> None:
        """Draw segments (n, 2, 3) [m] with optional colours `shades` (n, 2, 3) uint8."""
        self.handle.visible = len(points) > 0
        if not len(points):
            return
        if shades is None:
            shades = np.broadcast_to(self._colour, points.shape).copy()
        self.handle.points = points
        self.handle.colors = shades


class Model:
    """Model of the robot from its description: body with an arrow to its front, wheels, laser."""

    def __init__(self, scene: Any, name: str, robot: Robot, colour: Tuple[int, int, int]):
        base = robot.base
        body = robot.body
        self._frame = scene.add_frame(name, show_axes=False, visible=False)
        # Height of the base frame above the ground [m]
        self._height = base.wheel_radius - base.axle_height

        # viser places a box and a cylinder by their middle.
        length, width, body_height = body.size
        body_middle = (*body.centre, body.bottom + body_height / 2)
        body_name = f"{name}/body"
        if body.round:
            scene.add_cylinder(
                body_name,
                radius=0.5,
                height=body_height,
                scale=(length, width, 1.0),
                color=colour,
                position=body_middle,
            )
        else:
            scene.add_box(body_name, color=colour, dimensions=body.size, position=body_middle)

        # The arrow covers the body, because a laser may stand in its middle.
        arrow = np.array([(0.5, 0.0, 0.0), (-0.4, 0.4, 0.0), (-0.4, -0.4, 0.0)])
        scene.add_mesh_simple(
            f"{name}/front",
            arrow * (length, width, 0.0),
            np.array([(0, 1, 2)]),
            color=WHITE,
            side="double",
            position=(*body.centre, body.bottom + body_height + ABOVE_M),
        )

        turn_to_y = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # turns a cylinder's axis from z to y
        for number, (x, y) in enumerate(wheel_places(base)):
            scene.add_cylinder(
                f"{name}/wheel{number}",
                base.wheel_radius,
                base.wheel_width,
                color=RUBBER,
                wxyz=turn_to_y,
                position=(x, y, base.axle_height),
            )

        laser_x, laser_y, _ = robot.laser.pose
        laser_middle = (laser_x, laser_y, robot.laser.height)
        scene.add_cylinder(f"{name}/laser", 0.04, 0.06, color=BLACK, position=laser_middle)

    def put(self, pose: Optional[Pose]) -> None:
        """Move the model to the pose (x, y, yaw), or hide it if the pose is None."""
        self._frame.visible = pose is not None
        if pose is not None:
            put(self._frame, pose, self._height)


# Colour and opacity by occupancy, with -1 (unknown) last. Free and unknown cells are transparent.
SHADES = np.zeros((256, 4), np.uint8)
SHADES[1:99, :3] = rgb("part-5")
SHADES[1:99, 3] = np.linspace(20, 150, 98)
SHADES[99] = (*rgb("fast"), 170)  # inscribed
SHADES[100] = (*rgb("fast"), 240)  # lethal


class DrawnCostmap:
    """Costmap updated from whole maps and windows."""

    def __init__(self, scene: Any, name: str, z: float):
        self._z = z
        self._cells: Any = None  # occupancy (height, width) int8
        self._info = MapMetaData()
        self._frame = ""
        self._drawn = 0.0  # wall time of the last image [s]
        self._changed = False
        clear_image = np.zeros((1, 1, 4), np.uint8)
        self.handle = scene.add_image(name, clear_image, 1.0, 1.0, cast_shadow=False)

    def replace_map(self, message: Any) -> None:
        """Replace the costmap by a nav_msgs/OccupancyGrid."""
        self._info = message.info
        self._frame = message.header.frame_id
        self._changed = True
        shape = (message.info.height, message.info.width)
        self._cells = np.array(message.data, np.int8).reshape(shape)

    def patch_map(self, message: Any) -> None:
        """Apply a map_msgs/OccupancyGridUpdate."""
        # An update may be for a map that has not arrived yet.
        if self._cells is None:
            return
        row_count, column_count = self._cells.shape
        end_row = message.y + message.height
        end_column = message.x + message.width
        if end_row > row_count or end_column > column_count:
            return
        new_cells = np.reshape(message.data, (message.height, message.width))
        self._cells[message.y : end_row, message.x : end_column] = new_cells
        self._changed = True

    def draw(self, listener: Listener) -> None:
        """Draw the costmap if it has changed, at most once per PICTURE_PERIOD_S."""
        if not self._changed or time.monotonic() - self._drawn < PICTURE_PERIOD_S:
            return
        frame_pose = listener.frame_pose(self._frame)
        if frame_pose is None:
            return
        self._drawn = time.monotonic()
        self._changed = False
        info = self._info
        width = info.width * info.resolution
        height = info.height * info.resolution
        self.handle.image = SHADES[self._cells]
        self.handle.render_width = width
        self.handle.render_height = height
        self.handle.visible = True
        # viser places an image by its middle.
        corner = info.origin.position
        middle = (corner.x + width / 2, corner.y + height / 2, 0.0)
        put(self.handle, compose(frame_pose, middle), self._z)
