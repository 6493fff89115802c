"""World that a robot's laser saw during a drive: cells that a good share of the beams end in, as walls of a World.

What no beam has reached is free: a planner that explores may find out there what it likes.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple, Tuple

import numpy as np
import yaml

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.common.files import write_bytes
from applr_ros1.drives.drive import Drive, Motion, Scans
from applr_ros1.robots import Robot
from worlds import Course, World
from worlds.map_reader import FREE, OCCUPIED, boxes
from worlds.world import NO_CIRCLE_M, Grid

RESOLUTION_M = 0.05  # edge of a cell [m]
SCANS = 120  # largest number of scans that are used
BEAMS = 240  # largest number of beams of a scan that are used
HITS = 2  # least number of beams that end in an occupied cell
HIT_SHARE = 0.3  # least share of them among the beams that reach the cell
MARGIN_M = 1.0  # width of the margin around scans and drive [m]


class Rays(NamedTuple):
    """Beams of a drive in the odometry frame.

    Attributes:
        origins: (n, 2) places of the laser [m].
        directions: (n, 2) unit vectors.
        lengths: (n,) ranges, or the reach of the laser for beams without a return [m].
        hits: (n,) whether a beam has a return.
    """

    origins: np.ndarray
    directions: np.ndarray
    lengths: np.ndarray
    hits: np.ndarray


def seen_grid(drive: Drive, robot: Robot) -> Grid:
    """Return the map that the laser saw, in the odometry frame.

    Raises DriveError if odometry or scans are missing.
    """
    drive.require("odometry", "scans")
    assert drive.odometry is not None
    assert drive.scans is not None
    laser_pose = drive.laser_pose or robot.laser.pose
    rays = _rays(drive.scans, drive.odometry, laser_pose)
    ends = rays.origins + rays.lengths[:, None] * rays.directions
    places = np.vstack([ends[rays.hits], drive.odometry.pose[:, :2]])
    low = np.floor((places.min(axis=0) - MARGIN_M) / RESOLUTION_M) * RESOLUTION_M
    columns, rows = np.ceil((places.max(axis=0) + MARGIN_M - low) / RESOLUTION_M).astype(int)
    shape = int(rows), int(columns)

    ended = _counts(ends[rays.hits], low, shape)
    passed = _passed(rays, low, shape)
    share = ended / np.maximum(ended + passed, 1)
    occupied = (ended >= HITS) & (share >= HIT_SHARE)
    occupied &= ~_driven_over(drive.odometry, robot, low, shape)
    cells = np.where(occupied, OCCUPIED, FREE).astype(np.int8)
    return Grid(cells, RESOLUTION_M, (float(low[0]), float(low[1]), 0.0))


def seen_world(grid: Grid, name: str, start: Pose, goal: Pose) -> World:
    """Return a map that seen_grid() made as a world with a course, which the planner's report ends."""
    path = np.array([start[:2], goal[:2]])
    course = Course(start, goal, None, NO_CIRCLE_M, path, planner_ends=True)
    return World(name, np.zeros((0, 3)), boxes(grid), course)


def write_map(grid: Grid, path: str) -> None:
    """Write a map as map_saver does: path.yaml and, beside it, path.pgm."""
    image = Path(path).with_suffix(".pgm")
    pixels = np.where(grid.cells[::-1] == OCCUPIED, 0, 254).astype(np.uint8)
    from PIL import Image  # slow, and needed only here

    encoded = io.BytesIO()
    Image.fromarray(pixels).save(encoded, "PPM")
    write_bytes(str(image), encoded.getvalue())
    fields = {
        "image": image.name,
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_bytes(path, yaml.safe_dump(fields, sort_keys=False).encode())


def _rays(scans: Scans, odometry: Motion, laser_pose: Pose) -> Rays:
    """Return beams of scans that are evenly spread over a drive."""
    chosen = np.unique(np.linspace(0, len(scans) - 1, SCANS).astype(int))
    laser_x, laser_y, laser_yaw = laser_pose
    parts = []
    for row in chosen:
        first_angle, increment, range_min, range_max = scans.fan[row]
        step = max(1, len(scans.ranges[row]) // BEAMS)
        ranges = scans.ranges[row][::step].astype(float)
        pose = odometry.pose_at(scans.stamp[row])
        origin = transform_point(pose, laser_x, laser_y)
        angles = pose[2] + laser_yaw + first_angle + increment * step * np.arange(len(ranges))
        is_free = ~np.isfinite(ranges) | (ranges >= range_max)
        is_return = ~is_free & (ranges >= range_min)
        # Some lasers report 0 for beams without a return; others are too near to measure.
        is_valid = is_free | is_return
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        lengths = np.where(is_return, ranges, range_max)
        origins = np.broadcast_to(origin, directions.shape)
        parts.append(
            Rays(origins[is_valid], directions[is_valid], lengths[is_valid], is_return[is_valid])
        )
    return Rays(*(np.concatenate(column) for column in zip(*parts)))


def _passed(rays: Rays, low: np.ndarray, shape: Tuple[int, int]) -> np.ndarray:
    """Return how many beams pass through each cell (ny, nx) before they end."""
    total = np.zeros(shape, int)
    # The last cell belongs to the end of a beam.
    reach = rays.lengths - RESOLUTION_M
    for distance in np.arange(0.0, float(reach.max(initial=0.0)), RESOLUTION_M):
        goes_on = reach > distance
        points = rays.origins[goes_on] + distance * rays.directions[goes_on]
        total += _counts(points, low, shape)
    return total


def _counts(points: np.ndarray, low: np.ndarray, shape: Tuple[int, int]) -> np.ndarray:
    """Return the number of points (n, 2) in each cell (ny, nx) of a grid with its lower left corner at low (2,)."""
    columns, rows = np.floor((points - low) / RESOLUTION_M).astype(int).T
    is_inside = (columns >= 0) & (rows >= 0) & (columns < shape[1]) & (rows < shape[0])
    cells = rows[is_inside] * shape[1] + columns[is_inside]
    return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape)


def _driven_over(
    odometry: Motion, robot: Robot, low: np.ndarray, shape: Tuple[int, int]
) -> np.ndarray:
    """Return the cells (ny, nx) within the body of the robot at one of its poses."""
    length, width = robot.body.size[:2]
    centre_x, centre_y = robot.body.centre
    along = np.arange(-length / 2, length / 2 + 1e-9, RESOLUTION_M / 2) + centre_x
    across = np.arange(-width / 2, width / 2 + 1e-9, RESOLUTION_M / 2) + centre_y
    x, y = (offsets.ravel() for offsets in np.meshgrid(along, across))
    over = np.zeros(shape, bool)
    for pose in np.unique(odometry.pose.round(2), axis=0).tolist():
        points = np.column_stack(transform_point(pose, x, y))
        over |= _counts(points, low, shape) > 0
    return over
