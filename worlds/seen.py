"""A place as a robot's scans saw it: what stands there, what has gone, and what nothing was seen of.

training/bags/drive.py calls it with the scans of a recorded drive, placed in one frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Sequence, Tuple

import numpy as np
import scipy

from applr_ros1.common.files import MAX_CELLS

from .world import WorldError

CELL_M = 0.05  # [m]
REACH = 8.0  # [m]; what is farther from a scanner is not used
RADIUS_M = 0.04  # [m] of the cylinders that stand for a surface: they overlap, one in each cell
BEHIND_BEAM_M = 0.05  # [m] of their middles behind where beams end, most of which meet the surface aslant
MARGIN_M = 1.5 * CELL_M  # a cell is seen free where a beam goes so much farther
MIN_HITS, MIN_HIT_SHARE = 2, 0.2  # scans that must have hit a cell, and their share of those that hit a cell near it
GONE_SCANS = 5  # later scans that see a cell free, and nothing near it, where something that moves was
COARSE_CELLS = 2  # cells along a side of what stands for the unseen

Circles = np.ndarray  # (n, 3) x, y, radius [m]


class Scan(NamedTuple):
    """A scan with the scanner's pose (x, y, yaw); +inf: nothing within its range, NaN: no measurement."""

    pose: Tuple[float, float, float]
    angle_min: float
    increment: float
    ranges: np.ndarray


class Seen(NamedTuple):
    """Surfaces, the border of what was seen free to what nothing was seen of, and the area [m^2] of what has gone."""

    surfaces: Circles
    unseen: Circles
    gone: float


def seen(scans: Sequence[Scan], driven: np.ndarray, inner: float, outer: float) -> Seen:
    """Find what a drive's scans saw, by votes in a grid.

    Args:
        scans: In the order of time.
        driven: (n, 2) where the robot's middle was [m].
        inner: So far around it nothing can have stood [m].
        outer: So far around it what was not seen counts as free [m].

    Raises:
        WorldError: The drive is too long for one grid.
    """
    places = np.array([scan.pose[:2] for scan in scans])
    low = np.floor((places.min(axis=0) - REACH) / CELL_M) * CELL_M
    nx, ny = np.ceil((places.max(axis=0) + REACH - low) / CELL_M).astype(int)
    if nx * ny > MAX_CELLS:
        raise WorldError(f"the drive covers {nx * CELL_M:.0f} x {ny * CELL_M:.0f} m: give a bag of a shorter one")
    hits, free, since = np.zeros((ny, nx), np.int32), np.zeros((ny, nx), bool), np.zeros((ny, nx), np.int32)
    last, total, weight = np.full((ny, nx), -1, np.int32), np.zeros((2, ny, nx)), np.zeros((ny, nx))
    for number, scan in enumerate(scans):
        row, column, x, y = _hits(scan, low)
        np.add.at(weight, (row, column), 1.0)
        np.add.at(total, (0, row, column), x)
        np.add.at(total, (1, row, column), y)
        once = np.unique(row * nx + column)
        hits.ravel()[once] += 1
        last.ravel()[once] = number
    last = scipy.ndimage.maximum_filter(last, 3)  # what stands is hit in a cell or beside it
    for number, scan in enumerate(scans):
        block, passed, through = _free(scan, low, free.shape)
        free[block] |= passed
        since[block] += through & (last[block] < number)
    stands, gone = (hits >= MIN_HITS) & (since < GONE_SCANS), (hits >= MIN_HITS) & (since >= GONE_SCANS)
    stands &= hits >= MIN_HIT_SHARE * scipy.ndimage.maximum_filter(hits, 5)
    where = scipy.ndimage.distance_transform_edt(~_drawn(driven, low, free.shape)) * CELL_M
    at = stands & (where > inner)
    surfaces = np.column_stack([*(total[:, at] / weight[at]), np.full(at.sum(), RADIUS_M)])
    dark = ~(free | scipy.ndimage.binary_dilation(hits > 0, np.ones((5, 5)))) & scipy.ndimage.binary_dilation(
        free, np.ones((3, 3))
    )
    dark &= (where > outer) & (where < REACH)
    row, column = np.unique(np.argwhere(dark) // COARSE_CELLS, axis=0).reshape(-1, 2).T
    middle = low[:, None] + (np.array([column, row]) + 0.5) * COARSE_CELLS * CELL_M
    unseen = np.column_stack([*middle, np.full(len(row), 0.6 * COARSE_CELLS * CELL_M)])
    return Seen(surfaces, unseen, float(gone.sum()) * CELL_M**2)


def _hits(scan, low):
    """Rows and columns of the cells in which beams end, and x, y of points BEHIND_BEAM_M the surfaces there [m]."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    there = np.isfinite(ranges) & (ranges > 0.0) & (ranges < REACH - MARGIN_M)
    angle = scan.pose[2] + scan.angle_min + scan.increment * np.flatnonzero(there)
    c, s, found = np.cos(angle), np.sin(angle), ranges[there]
    column, row = (np.floor((scan.pose[k] + found * d - low[k]) / CELL_M).astype(int) for k, d in ((0, c), (1, s)))
    return row, column, scan.pose[0] + (found + BEHIND_BEAM_M) * c, scan.pose[1] + (found + BEHIND_BEAM_M) * s


def _free(scan, low, shape):
    """A block of the grid around a scanner, and of its cells: those seen free, and those that beams go well beyond."""
    x, y, yaw = scan.pose
    column, row = (int((place - corner) / CELL_M) for place, corner in zip((x, y), low))
    reach = int(REACH / CELL_M)
    block = slice(max(0, row - reach), row + reach), slice(max(0, column - reach), column + reach)
    rows, columns = (np.arange(*part.indices(n)) for part, n in zip(block, shape))
    dx = low[0] + (columns[None, :] + 0.5) * CELL_M - x
    dy = low[1] + (rows[:, None] + 0.5) * CELL_M - y
    distance = np.hypot(dx, dy)
    turn = (np.arctan2(dy, dx) - yaw - scan.angle_min) * np.sign(scan.increment) % (2.0 * math.pi)
    beam = np.rint(turn / abs(scan.increment)).astype(int)
    n = len(scan.ranges)
    ranges = np.nan_to_num(np.asarray(scan.ranges, dtype=np.float64), nan=0.0, posinf=np.inf, neginf=0.0)
    least = scipy.ndimage.minimum_filter1d(ranges, 3, mode="nearest")
    inside, beam = (beam < n) & (distance < REACH), np.minimum(beam, n - 1)
    return block, inside & (distance + CELL_M < ranges[beam]), inside & (distance + MARGIN_M < least[beam])


def _drawn(points, low, shape):
    """(ny, nx) bool: the cells of points (n, 2)."""
    drawn = np.zeros(shape, bool)
    column, row = np.floor((points - low) / CELL_M).astype(int).T
    drawn[np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)] = True
    return drawn
