"""Elements of the viewer's scene: colours, lines, the robot's model, and costmaps as textures."""

from __future__ import annotations

import time
from typing import Any, Optional, Tuple

import numpy as np
from nav_msgs.msg import MapMetaData

from applr_ros1.common.angles import Pose, quaternion_of
from applr_ros1.common.pages.colors import rgb
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import wheel_places

from .listening import Listener
from .look import CHEAP, DEAR

RUBBER = (40, 40, 45)  # colour of the wheels
BLACK = (20, 20, 25)  # colour of the laser
PICTURE_PERIOD_S = 0.5  # shortest wall time between two images of a costmap [s]


def colours(costs: np.ndarray) -> np.ndarray:
    """Return colours (n, 3) uint8 for costs (n,) from 0 to 1."""
    # Each channel goes from the cheap colour to the dear one with the cost.
    share = np.clip(costs, 0.0, 1.0)[:, None]
    shades: np.ndarray = (1.0 - share) * rgb(CHEAP) + share * rgb(DEAR)
    return shades.astype(np.uint8)


def lifted(points: np.ndarray, z: float) -> np.ndarray:
    """Return points (n, 2) as (n, 3) float32 at height z [m]."""
    return np.column_stack([points, np.full(len(points), z)]).astype(np.float32)


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
        points = np.zeros((1, 2, 3))
        shades = points.astype(np.uint8)
        self.handle = scene.add_line_segments(
            name, points, shades, thickness=thickness, visible=False
        )

    def path(self, points: np.ndarray, z: float) -> None:
        """Draw a line through points (n, 2) at height z [m]."""
        flat = lifted(points, z)
        self.segments(np.stack([flat[:-1], flat[1:]], axis=1))

    def segments(self, points: np.ndarray, shades: Optional[np.ndarray] = None) -> None:
        """Draw segments (n, 2, 3) [m] with optional colours `shades` (n, 2, 3) uint8."""
        self.handle.visible = len(points) > 0
        if not len(points):
            return
        if shades is None:
            shades = np.broadcast_to(self._colour, points.shape).copy()
        self.handle.points = points
        self.handle.colors = shades


class Model:
    """Model of the robot from its description: body, wheels and laser."""

    def __init__(self, scene: Any, name: str, robot: Robot, colour: Tuple[int, int, int]):
        base = robot.base
        body = robot.body
        self._frame = scene.add_frame(name, show_axes=False, visible=False)
        # Height of the base frame above the ground [m]
        self._height = base.wheel_radius - base.axle_height

        height = body.size[2]
        middle = (*body.centre, body.bottom + height / 2)
        scene.add_box(f"{name}/body", color=colour, dimensions=body.size, position=middle)
        for number, (x, y) in enumerate(wheel_places(base)):
            scene.add_cylinder(
                f"{name}/wheel{number}",
                base.wheel_radius,
                base.wheel_width,
                color=RUBBER,
                wxyz=(np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0),  # turns a cylinder's axis from z to y
                position=(x, y, base.axle_height),
            )
        x, y, _ = robot.laser.pose
        position = (x, y, robot.laser.height)
        scene.add_cylinder(f"{name}/laser", 0.04, 0.06, color=BLACK, position=position)

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


class Costmap:
    """Costmap updated from whole maps and windows.

    Draws only the bounding box of the cells that are not free: a global costmap is large.
    """

    def __init__(self, scene: Any, name: str, z: float):
        self._z = z
        self._cells: Any = None  # occupancy (height, width) int8
        self._info = MapMetaData()
        self._frame = ""
        self._drawn = 0.0  # wall time of the last image [s]
        self._changed = False
        nothing = np.zeros((1, 1, 4), np.uint8)
        self.handle = scene.add_image(name, nothing, 1.0, 1.0, cast_shadow=False)

    def take(self, message: Any) -> None:
        """Replace the costmap by a nav_msgs/OccupancyGrid."""
        self._info = message.info
        self._frame = message.header.frame_id
        self._changed = True
        shape = (message.info.height, message.info.width)
        self._cells = np.array(message.data, np.int8).reshape(shape)

    def update(self, message: Any) -> None:
        """Apply a map_msgs/OccupancyGridUpdate."""
        # An update may be for a map that has not arrived yet.
        end_x = message.x + message.width
        end_y = message.y + message.height
        if self._cells is None or np.any(np.less(self._cells.shape, (end_y, end_x))):
            return
        cells = np.reshape(message.data, (message.height, message.width))
        self._cells[message.y : end_y, message.x : end_x] = cells
        self._changed = True

    def draw(self, listener: Listener) -> None:
        """Draw the costmap if it has changed, at most once per PICTURE_PERIOD_S."""
        if not self._changed or time.monotonic() - self._drawn < PICTURE_PERIOD_S:
            return
        pose = listener.frame_pose(self._frame)
        if pose is None:
            return
        self._drawn = time.monotonic()
        self._changed = False
        rows = np.flatnonzero(self._cells.any(axis=1))
        columns = np.flatnonzero(self._cells.any(axis=0))
        if not len(rows):
            return

        # The window around all cells that are not free
        left = columns[0]
        right = columns[-1] + 1
        bottom = rows[0]
        top = rows[-1] + 1
        resolution = self._info.resolution
        self.handle.visible = True
        self.handle.image = SHADES[self._cells[bottom:top, left:right]]
        self.handle.render_width = float((right - left) * resolution)
        self.handle.render_height = float((top - bottom) * resolution)

        # viser places an image by its middle.
        corner = self._info.origin.position
        frame_x, frame_y, _ = pose
        x = frame_x + corner.x + (left + right) / 2.0 * resolution
        y = frame_y + corner.y + (bottom + top) / 2.0 * resolution
        self.handle.position = (x, y, self._z)
