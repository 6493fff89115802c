"""Elements of the viewer's scene: colours, lines, the robot's model, and costmaps as textures on the ground."""

from __future__ import annotations

import time
from typing import Any, Optional, Tuple

import numpy as np
from nav_msgs.msg import MapMetaData

from applr_ros1.common.angles import Pose, quaternion_of
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import wheel_places

from .listening import Listener

RAMP = np.array(
    [[40, 70, 200], [30, 170, 200], [60, 190, 80], [240, 190, 40], [220, 50, 40]]
)  # colours, low to high
PICTURE_PERIOD_S = 0.5  # shortest wall time between two images of a costmap [s]


def colours(share: Any) -> np.ndarray:
    """Return colours (n, 3) uint8 for shares (n,) from 0 (blue) to 1 (red)."""
    share = np.clip(np.asarray(share, np.float64), 0.0, 1.0) * (len(RAMP) - 1)
    return np.stack(
        [np.interp(share, range(len(RAMP)), RAMP[:, k]) for k in range(3)], axis=1
    ).astype(np.uint8)


def lifted(points: np.ndarray, z: float) -> np.ndarray:
    """Return points (n, 2) as (n, 3) float32 at height z [m]."""
    return np.column_stack([points, np.full(len(points), z)]).astype(np.float32)


def put(handle: Any, pose: Pose, z: float = 0.0) -> None:
    """Move a handle to the pose (x, y, yaw) at height z [m]."""
    x, y, sine, cosine = quaternion_of(pose[2])
    handle.position, handle.wxyz = (*pose[:2], z), (cosine, x, y, sine)


class Lines:
    """Line segments that can be updated."""

    def __init__(self, scene: Any, name: str, colour: Tuple[int, int, int], thickness: float):
        self._colour = np.array(colour, np.uint8)
        nothing = np.zeros((1, 2, 3)), np.zeros((1, 2, 3), np.uint8)
        self.handle = scene.add_line_segments(name, *nothing, thickness=thickness, visible=False)

    def path(self, points: np.ndarray, z: float) -> None:
        """Draw a line through points (n, 2) at height z [m]."""
        flat = lifted(points, z)
        self.segments(np.stack([flat[:-1], flat[1:]], axis=1))

    def segments(self, points: np.ndarray, shades: Optional[np.ndarray] = None) -> None:
        """Draw segments (n, 2, 3) [m] with optional colours `shades` (n, 2, 3) uint8."""
        self.handle.visible = len(points) > 0
        if len(points):
            shades = (
                np.broadcast_to(self._colour, points.shape).copy() if shades is None else shades
            )
            self.handle.points, self.handle.colors = points, shades


class Model:
    """Model of the robot from its description: body, wheels and laser."""

    def __init__(self, scene: Any, name: str, robot: Robot, colour: Tuple[int, int, int]):
        base, body = robot.base, robot.body
        self._height = (
            base.wheel_radius - base.axle_height
        )  # height of the base frame above the ground [m]
        self._frame = scene.add_frame(name, show_axes=False, visible=False)
        middle = (*body.centre, body.bottom + body.size[2] / 2)
        scene.add_box(name + "/body", color=colour, dimensions=body.size, position=middle)
        aside = (
            np.sqrt(0.5),
            np.sqrt(0.5),
            0.0,
            0.0,
        )  # rotation about x that turns a cylinder's axis to y
        for k, (x, y) in enumerate(wheel_places(base)):
            wheel, place = f"{name}/wheel{k}", (x, y, base.axle_height)
            size = base.wheel_radius, base.wheel_width
            scene.add_cylinder(wheel, *size, color=(40, 40, 45), wxyz=aside, position=place)
        place = (*robot.laser.pose[:2], robot.laser.height)
        scene.add_cylinder(name + "/laser", 0.04, 0.06, color=(20, 20, 25), position=place)

    def put(self, pose: Optional[Pose]) -> None:
        """Move the model to the pose (x, y, yaw), or hide it if the pose is None."""
        self._frame.visible = pose is not None
        if pose is not None:
            put(self._frame, pose, self._height)


SHADES = np.zeros((256, 4), np.uint8)  # colour and opacity by occupancy, with -1 (unknown) last
SHADES[1:99, :3], SHADES[1:99, 3] = colours(np.linspace(0.1, 0.75, 98)), np.linspace(50, 170, 98)
SHADES[99], SHADES[100] = (230, 80, 60, 190), (120, 20, 90, 220)


class Costmap:
    """Costmap updated from whole maps and windows. Draws only the bounding box of the cells that are not free."""

    def __init__(self, scene: Any, name: str, z: float):
        self._z = z
        self._cells: Any = None  # occupancy (height, width) int8
        self._info, self._frame, self._drawn, self._changed = MapMetaData(), "", 0.0, False
        self.handle = scene.add_image(
            name, np.zeros((1, 1, 4), np.uint8), 1.0, 1.0, cast_shadow=False
        )

    def take(self, message: Any) -> None:
        """Replace the costmap by a nav_msgs/OccupancyGrid."""
        self._info, self._frame, self._changed = message.info, message.header.frame_id, True
        self._cells = np.array(message.data, np.int8).reshape(
            message.info.height, message.info.width
        )

    def update(self, message: Any) -> None:
        """Apply a map_msgs/OccupancyGridUpdate."""
        x, y, n, m = message.x, message.y, message.width, message.height
        if (
            self._cells is not None
            and y + m <= self._cells.shape[0]
            and x + n <= self._cells.shape[1]
        ):
            self._cells[y : y + m, x : x + n] = np.reshape(message.data, (m, n))
            self._changed = True

    def draw(self, listener: Listener) -> None:
        """Draw the costmap if it has changed, at most once per PICTURE_PERIOD_S."""
        due = self._changed and time.monotonic() - self._drawn >= PICTURE_PERIOD_S
        place = listener.frame_pose(self._frame) if due else None
        if place is None:
            return
        self._drawn, self._changed = time.monotonic(), False
        rows, columns = (np.flatnonzero(self._cells.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return
        (y0, y1), (x0, x1) = (rows[0], rows[-1] + 1), (columns[0], columns[-1] + 1)
        cell, corner, handle = self._info.resolution, self._info.origin.position, self.handle
        handle.visible = True
        handle.image = SHADES[self._cells[y0:y1, x0:x1]]
        handle.render_width, handle.render_height = (x1 - x0) * cell, (y1 - y0) * cell
        x, y = corner.x + (x0 + x1) / 2 * cell, corner.y + (y0 + y1) / 2 * cell
        handle.position = place[0] + x, place[1] + y, self._z
