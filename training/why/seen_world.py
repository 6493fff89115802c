"""World that a robot's laser saw during a drive: its walls are cells in which many beams end.

What no beam has reached is free but right behind a wall: a planner that explores may find out there
what it likes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
import yaml

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.common.files import write_bytes
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import Motion
from applr_ros1.robots import Robot
from applr_ros1.why.recording import Recording
from worlds import Course, World
from worlds.map_reader import FREE, OCCUPIED, boxes
from worlds.world import NO_CIRCLE_M, Grid

# Edge of a cell in which robots drive [m]: coarser cells close gaps that small robots pass.
RESOLUTION_M = 0.02
MAP_RESOLUTION_M = 0.05  # edge of a cell of a map that is written, as of map_saver's usual ones [m]
SCANS = 120  # largest number of scans that are used
REACH = 0.7  # distance of a corner from the centre of a cell [cells]
PASSING_SHARE = 0.7  # largest share of the beams at an occupied cell that pass its centre
BEHIND_M = 0.1  # depth behind a hit of what is occupied unless a beam passes through it [m]
MARGIN_M = 1.0  # width of the margin around scans and drive [m]


def seen_grid(recording: Recording, resolution: float = RESOLUTION_M) -> Grid:
    """Return the map that the laser saw, in the odometry frame.

    Args:
        recording: The recorded drive.
        resolution: Edge of a cell [m].
    """
    odometry = recording.odometry
    chosen_rows = np.linspace(0, len(recording.scans) - 1, SCANS).astype(int)
    scans = [recording.scan(row) for row in np.unique(chosen_rows).tolist()]
    hit_points = np.vstack([_hit_points(scan, resolution) for scan in scans])

    # Cells lie on multiples of the resolution, so that maps of one place have the same cells.
    hit_cells = np.unique(np.floor(hit_points / resolution).astype(int), axis=0)
    centres = (hit_cells + 0.5) * resolution
    is_occupied = _is_solid(scans, centres, REACH * resolution)
    # The robot was where it drove, so that nothing else was.
    is_occupied &= ~_driven_over(odometry, recording.robot, centres)

    places = np.vstack([hit_points, odometry.pose[:, :2]])
    first_cell = np.floor((places.min(axis=0) - MARGIN_M) / resolution).astype(int)
    last_cell = np.floor((places.max(axis=0) + MARGIN_M) / resolution).astype(int)
    column_count, row_count = last_cell - first_cell + 1
    columns, rows = (hit_cells[is_occupied] - first_cell).T
    cells = np.full((row_count, column_count), FREE, np.int8)
    cells[rows, columns] = OCCUPIED
    x, y = (first_cell * resolution).tolist()
    return Grid(cells, resolution, (x, y, 0.0))


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
    image_path = Path(path).with_suffix(".pgm")
    # An image begins at the top, a map at the bottom. map_saver writes black and near white.
    is_occupied = grid.cells[::-1] == OCCUPIED
    is_occupied[[0, -1]] = True
    is_occupied[:, [0, -1]] = True
    pixels = np.where(is_occupied, 0, 254).astype(np.uint8)
    row_count, column_count = pixels.shape
    header = f"P5\n{column_count} {row_count}\n255\n".encode()
    write_bytes(str(image_path), header + pixels.tobytes())
    map_fields = {
        "image": image_path.name,
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_bytes(path, yaml.safe_dump(map_fields, sort_keys=False).encode())


def _hit_points(scan: LaserScan, spacing: float) -> np.ndarray:
    """Return points (k, 2) [m] where beams end, and others up to BEHIND_M behind them.

    Args:
        scan: The scan.
        spacing: Distance of the points of a beam [m].
    """
    beams = np.flatnonzero(np.isfinite(scan.distances))
    depths = np.arange(0.0, BEHIND_M, spacing)
    angles = np.repeat(scan.angle_min + scan.angle_increment * beams, len(depths))
    ranges = np.add.outer(scan.distances[beams], depths).ravel()
    x, y = transform_point(scan.sensor_pose, ranges * np.cos(angles), ranges * np.sin(angles))
    return np.column_stack([x, y])


def _excess(scan: LaserScan, points: np.ndarray) -> np.ndarray:
    """Return how far the beams towards points (k, 2) go beyond them (k,) [m].

    The excess is negative for points behind what a beam shows, NaN where there is no beam.
    """
    ahead, left = transform_point(inverse(scan.sensor_pose), *points.T)
    # Some lasers count their beams clockwise.
    turns = np.copysign(1.0, scan.angle_increment) * (np.arctan2(left, ahead) - scan.angle_min)
    beams = np.rint(turns % (2.0 * np.pi) / abs(scan.angle_increment)).astype(int)
    ranges = np.append(scan.distances, np.nan)[beams.clip(max=len(scan.ranges))]
    excess: np.ndarray = ranges.clip(max=scan.range_max) - np.hypot(ahead, left)
    return excess


def _is_solid(scans: Sequence[LaserScan], points: np.ndarray, reach: float) -> np.ndarray:
    """Return whether enough beams that come within `reach` [m] of each point (n, 2) end before it.

    Obstacles whose beams may end behind the point would grow, and close the gaps of small robots.
    A point that no beam reaches lies behind what was hit, which is not as thin as a line. Single
    beams end in free space at edges, and an obstacle that moved on is seen through later.
    """
    passing_beams = np.zeros(len(points), int)
    reaching_beams = np.zeros(len(points), int)
    for scan in scans:
        excess = _excess(scan, points)
        passing_beams += excess > 0.0
        reaching_beams += excess >= -reach
    is_solid: np.ndarray = passing_beams <= PASSING_SHARE * reaching_beams
    return is_solid


def _driven_over(odometry: Motion, robot: Robot, points: np.ndarray) -> np.ndarray:
    """Return whether each point (n, 2) lies within the body of the robot at one of its poses."""
    half_size = 0.5 * np.array(robot.body.size[:2])
    is_driven_over = np.zeros(len(points), bool)
    # A robot that stands repeats its pose in every message.
    distinct_poses = np.unique(odometry.pose.round(2), axis=0)
    for pose in distinct_poses.tolist():
        ahead, left = transform_point(inverse(pose), *points.T)
        offsets = np.abs(np.column_stack([ahead, left]) - robot.body.centre)
        is_driven_over |= (offsets <= half_size).all(axis=1)
    return is_driven_over
