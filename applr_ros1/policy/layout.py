"""Layout of what a policy sees of the world: the beams of its scan, their cap, and the distance of its local goal.

The layout belongs to the policy's file, not to the laser. Any planar scan that covers it is resampled to it, so a
policy drives with scanners of other beams than it was trained with. The applr node, the training environment and the
bag reader call it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Dict, Mapping, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError

ANGLE_TOLERANCE_RAD = 0.02  # by which a scan may end before the layout does
COARSEST_RAD = math.radians(3.0)  # between two beams of a scan; posts of .15 m are 4 degrees wide at 2 m
TURN_RAD = 2.0 * math.pi
IN_FILES = {  # names of a layout's fields in files
    **{"beams": "beams", "range_cap_m": "range_cap", "lookahead_m": "lookahead"},
    **{"angle_min_rad": "angle_min", "angle_max_rad": "angle_max"},
}


class ObservationError(ApplrError):
    """A scan or plan that no observation can be made of; one line says what, which value and what to do."""


@dataclass(frozen=True)
class Layout:
    """The scan and local goal of an observation, beside the parameters of the space.

    Attributes:
        beams: Sectors of the scan, evenly spaced.
        angle_min: Direction of the first one's middle [rad], counted from straight ahead to the left.
        angle_max: Direction of the last one's middle [rad]; more than angle_min.
        range_cap: Ranges [m] beyond it count as free.
        lookahead: The local goal is the first point of the global plan farther away than this [m].
    """

    beams: int = 720
    angle_min: float = -2.35619
    angle_max: float = 2.35619
    range_cap: float = 2.0
    lookahead: float = 1.0

    @property
    def step(self) -> float:
        """Angle between two beams [rad]."""
        return (self.angle_max - self.angle_min) / (self.beams - 1)

    def to_dict(self) -> Dict[str, Any]:
        """Return what a policy's file holds of it, JSON values."""
        return {key: getattr(self, name) for key, name in IN_FILES.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Layout":
        """Make the layout that to_dict described."""
        return cls(**{name: values[key] for key, name in IN_FILES.items()})

    def sector(self, bearing: float, width: float) -> np.ndarray:
        """Return indices of the beams within width / 2 of a bearing [rad]."""
        angles = self.angle_min + self.step * np.arange(self.beams)
        return np.flatnonzero(np.abs((angles - bearing + math.pi) % TURN_RAD - math.pi) <= 0.5 * width)

    def resample(self, ranges: Any, angle_min: float, angle_increment: float) -> np.ndarray:
        """Return a scan as this layout has it: (beams,) float32 [m]; one of exactly this geometry comes back as it is.

        Each of the layout's beams is a sector of `step` radians and takes the smallest of the scan's ranges in it, so
        that no obstacle is lost; a sector between two beams of a coarser scan takes the nearer one. By REP 117 -inf
        (too near) is smaller than every range, +inf (no return) larger, and NaN (no measurement) is left where a sector
        has nothing else. 0, by which older drivers mean that nothing was measured, counts as NaN.

        Args:
            ranges: (n,) [m].
            angle_min: Direction of the first range [rad], counted from straight ahead to the left.
            angle_increment: From one range to the next [rad]; less than 0 where the scanner turns clockwise.

        Raises:
            ObservationError: The scan does not cover the layout, is coarser than COARSEST_RAD, or has no geometry.
        """
        ranges = np.asarray(ranges, dtype=np.float32)
        zero = ranges == 0.0
        if zero.any():  # before the smallest is taken: 0 would be it
            ranges = np.where(zero, np.float32(np.nan), ranges)
        source, starts = _sectors(self, len(ranges), float(angle_min), float(angle_increment))
        if len(source):
            ranges = np.fmin.reduceat(ranges[source], starts)
        return ranges


@lru_cache(maxsize=32)
def _sectors(layout: Layout, count: int, first: float, step: float) -> Tuple[np.ndarray, np.ndarray]:
    """Find the scan's ranges that each of the layout's beams takes.

    Returns:
        (source, starts): beam i takes source[starts[i] : starts[i + 1]]; both are empty where the geometry is the same.
    """
    if count < 2 or not (math.isfinite(first) and math.isfinite(step)) or step == 0.0:
        raise ObservationError(
            "scan has %d beams from %g rad every %g rad: no geometry; check the laser's driver" % (count, first, step)
        )
    if abs(step) > COARSEST_RAD:
        raise ObservationError(
            "scan has a beam every %.3f rad: at most %.3f are needed; use a finer scanner or setting"
            % (abs(step), COARSEST_RAD)
        )
    last, half = first + step * (count - 1), 0.5 * layout.step
    if count == layout.beams and abs(first - layout.angle_min) < half and abs(last - layout.angle_max) < half:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # each range once in every turn, and by direction; turns beside the layout's own are in its sectors too
    turns = TURN_RAD * np.arange(-2, 3)
    angles = (first + step * np.arange(count) + turns[:, None]).ravel()
    order = np.argsort(angles, kind="stable")
    angles, source = angles[order], np.tile(np.arange(count), len(turns))[order]
    middles = layout.angle_min + layout.step * np.arange(layout.beams)
    right = np.clip(np.searchsorted(angles, middles), 1, len(angles) - 1)
    nearest = right - (middles - angles[right - 1] <= angles[right] - middles)
    covered = np.abs(angles[nearest] - middles) <= 0.5 * abs(step) + ANGLE_TOLERANCE_RAD
    if not covered.all():
        raise ObservationError(
            "scan of %d beams covers %.3f to %.3f rad: the policy looks from %.3f to %.3f"
            % (count, min(first, last), max(first, last), layout.angle_min, layout.angle_max)
        )
    begins, ends = (np.searchsorted(angles, middles + offset) for offset in (-half, half))
    empty = begins == ends
    begins, ends = np.where(empty, nearest, begins), np.where(empty, nearest + 1, ends)
    lengths = ends - begins
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    taken = np.repeat(begins - starts, lengths) + np.arange(lengths.sum())
    return source[taken], starts
