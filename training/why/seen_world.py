"""World that a robot's laser saw during a drive: its walls are cells in which many beams end.

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
from applr_ros1.drives.drive import Motion, Scans
from applr_ros1.robots import Robot
from applr_ros1.why.recording import Recording
from worlds import Course, World
from worlds.map_reader import FREE, OCCUPIED, boxes
from worlds.world import NO_CIRCLE_M, Grid

RESOLUTION_M = 0.05  # edge of a cell [m]
SCANS = 120  # largest number of scans that are used
BEAMS = 240  # largest number of beams of a scan that are used
HITS = 2  # least number of beams that end in an occupied cell
HIT_SHARE = 0.3  # least share of them among the beams that reach the cell
MARGIN_M = 1.0  # width of the margin around scans and drive [m]


class DriveBeams(NamedTuple):
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


class Raster(NamedTuple):
    """Cells of a map.

    Attributes:
        corner: (2,) lower left corner x, y [m].
        shape: Numbers of rows and columns.
    """

    corner: np.ndarray
    shape: Tuple[int, int]


def seen_grid(recording: Recording) -> Grid:
    """Return the map that the laser saw, in the odometry frame."""
    odometry = recording.odometry
    rays = _rays(recording.scans, odometry, recording.laser_pose)
    beam_ends = rays.origins + rays.lengths[:, None] * rays.directions
    hit_points = beam_ends[rays.hits]
    driven_path = odometry.pose[:, :2]
    raster = _raster_around(np.vstack([hit_points, driven_path]))

    # A cell is occupied if enough of the beams that reach it end there: single beams end in free
    # space at edges, and an obstacle that moved on is seen through later.
    ending_beams = _counts(hit_points, raster)
    passing_beams = _passed(rays, raster)
    reaching_beams = ending_beams + passing_beams
    hit_share = ending_beams / np.maximum(reaching_beams, 1)
    is_occupied = (ending_beams >= HITS) & (hit_share >= HIT_SHARE)
    # The robot was there, so that nothing else was.
    is_occupied &= ~_driven_over(odometry, recording.robot, raster)
    cells = np.where(is_occupied, OCCUPIED, FREE).astype(np.int8)
    x, y = raster.corner.tolist()
    return Grid(cells, RESOLUTION_M, (x, y, 0.0))


def seen_world(grid: Grid, name: str, start: Pose, goal: Pose) -> World:
    """Return a map that seen_grid() made as a world whose course ends when the planner says so."""
    course_path = np.array([start[:2], goal[:2]])
    course = Course(start, goal, None, NO_CIRCLE_M, course_path, planner_ends=True)
    return World(name, np.zeros((0, 3)), boxes(grid), course)


def write_map(grid: Grid, path: str) -> None:
    """Write a map as map_saver does: path.yaml and, beside it, path.pgm.

    Its edge is occupied. Cells that no beam has reached are free, and floor that reaches the edge
    of a map counts as outside, where no courses begin.
    """
    from PIL import Image  # slow, and needed only here

    image_path = Path(path).with_suffix(".pgm")
    # An image begins at the top, a map at the bottom. map_saver writes black and near white.
    is_occupied = grid.cells[::-1] == OCCUPIED
    is_occupied[[0, -1]] = True
    is_occupied[:, [0, -1]] = True
    pixels = np.where(is_occupied, 0, 254).astype(np.uint8)
    image_buffer = io.BytesIO()
    Image.fromarray(pixels).save(image_buffer, "PPM")
    write_bytes(str(image_path), image_buffer.getvalue())
    map_fields = {
        "image": image_path.name,
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_bytes(path, yaml.safe_dump(map_fields, sort_keys=False).encode())


def _rays(scans: Scans, odometry: Motion, laser_pose: Pose) -> DriveBeams:
    """Return beams of scans that are evenly spread over a drive."""
    chosen_rows = np.linspace(0, len(scans) - 1, SCANS).astype(int)
    rays_by_scan = []
    for scan_row in np.unique(chosen_rows):
        rays_by_scan.append(_rays_of(scans, int(scan_row), odometry, laser_pose))
    # The beams of all scans, one after the other
    origins, directions, lengths, hits = map(np.concatenate, zip(*rays_by_scan))
    return DriveBeams(origins, directions, lengths, hits)


def _rays_of(scans: Scans, row: int, odometry: Motion, laser_pose: Pose) -> DriveBeams:
    """Return beams of one scan."""
    first_angle, increment, _, range_max = scans.fan[row]
    # Neighbouring beams of a fine scan end in the same cells.
    beam_step = max(1, len(scans.ranges[row]) // BEAMS)
    ranges = scans.distances(row)[::beam_step].astype(float)
    is_return = np.isfinite(ranges)
    is_valid = is_return | np.isposinf(ranges)

    x, y, yaw = odometry.pose_at(scans.stamp[row])
    laser_x, laser_y, laser_yaw = laser_pose
    origin = transform_point((x, y, yaw), laser_x, laser_y)
    first_direction = yaw + laser_yaw + first_angle
    angles = first_direction + increment * beam_step * np.arange(len(ranges))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    lengths = np.where(is_return, ranges, range_max)
    origins = np.broadcast_to(origin, directions.shape)
    return DriveBeams(
        origins=origins[is_valid],
        directions=directions[is_valid],
        lengths=lengths[is_valid],
        hits=is_return[is_valid],
    )


def _raster_around(points: np.ndarray) -> Raster:
    """Return the cells of a map that holds points (n, 2) [m] and a margin around them.

    Corners lie on multiples of the resolution, so that maps of one place have the same cells.
    """
    lowest = points.min(axis=0) - MARGIN_M
    highest = points.max(axis=0) + MARGIN_M
    corner = np.floor(lowest / RESOLUTION_M) * RESOLUTION_M
    size_in_cells = np.ceil((highest - corner) / RESOLUTION_M)
    columns, rows = size_in_cells.astype(int).tolist()
    return Raster(corner, (rows, columns))


def _passed(rays: DriveBeams, raster: Raster) -> np.ndarray:
    """Return how many beams pass through each cell (ny, nx) before they end."""
    beam_counts = np.zeros(raster.shape, int)
    # The last cell belongs to the end of a beam.
    free_lengths = rays.lengths - RESOLUTION_M
    farthest = float(free_lengths.max(initial=0.0))
    for distance in np.arange(0.0, farthest, RESOLUTION_M):
        goes_on = free_lengths > distance
        points = rays.origins[goes_on] + distance * rays.directions[goes_on]
        beam_counts += _counts(points, raster)
    return beam_counts


def _counts(points: np.ndarray, raster: Raster) -> np.ndarray:
    """Return the number of points (n, 2) [m] in each cell (ny, nx)."""
    row_count, column_count = raster.shape
    offsets_in_cells = (points - raster.corner) / RESOLUTION_M
    columns, rows = np.floor(offsets_in_cells).astype(int).T
    is_inside = (columns >= 0) & (columns < column_count)
    is_inside &= (rows >= 0) & (rows < row_count)
    # One number for each cell, row after row
    cell_numbers = rows[is_inside] * column_count + columns[is_inside]
    counts = np.bincount(cell_numbers, minlength=row_count * column_count)
    return counts.reshape(raster.shape)


def _driven_over(odometry: Motion, robot: Robot, raster: Raster) -> np.ndarray:
    """Return the cells (ny, nx) within the body of the robot at one of its poses."""
    # Points on the body at half of a cell's distance, so that no cell between them is missed
    body_length, body_width = robot.body.size[:2]
    centre_x, centre_y = robot.body.centre
    spacing = RESOLUTION_M / 2
    forward = np.arange(-body_length / 2, body_length / 2 + 1e-9, spacing) + centre_x
    lateral = np.arange(-body_width / 2, body_width / 2 + 1e-9, spacing) + centre_y
    grid_x, grid_y = np.meshgrid(forward, lateral)

    is_driven_over = np.zeros(raster.shape, bool)
    # A robot that stands repeats its pose in every message.
    distinct_poses = np.unique(odometry.pose.round(2), axis=0)
    for pose in distinct_poses.tolist():
        x, y = transform_point(pose, grid_x.ravel(), grid_y.ravel())
        body_points = np.column_stack([x, y])
        is_driven_over |= _counts(body_points, raster) > 0
    return is_driven_over
