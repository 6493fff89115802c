"""Layout of a policy's scan and local goal: number and directions of beams, range cap, and lookahead distance.

The layout belongs to the policy's file, not to the laser. Any planar scan that covers the layout is resampled to it, so
that a policy also works with other scanners than in its training. The applr node, the training environment and the bag
reader use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Dict, Mapping, Tuple

import numpy as np

from applr_ros1.common.arrays import Array32, Ints
from applr_ros1.common.errors import ApplrError

ANGLE_TOLERANCE_RAD = 0.02  # angle by which a scan may be narrower than the layout, on each side [rad]
COARSEST_RAD = math.radians(3.0)  # largest angle between two beams [rad]; a post of 0.15 m spans 4 degrees at 2 m
TURN_RAD = 2.0 * math.pi  # full turn [rad]
IN_FILES = {  # names of a layout's fields in files
    **{"beams": "beams", "range_cap_m": "range_cap", "lookahead_m": "lookahead"},
    **{"angle_min_rad": "angle_min", "angle_max_rad": "angle_max"},
}


class ObservationError(ApplrError):
    """Error for a scan or plan from which no observation can be made. Its message is one line."""


@dataclass(frozen=True)
class Layout:
    """Layout of the scan and local goal in an observation.

    Attributes:
        beams: Number of evenly spaced sectors of the scan.
        angle_min: Direction of the first sector's centre [rad], 0 straight ahead, positive to the left.
        angle_max: Direction of the last sector's centre [rad]; larger than angle_min.
        range_cap: Range beyond which space counts as free [m].
        lookahead: Distance of the local goal [m]: the first point of the global plan farther away than this.
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
        """Return the layout as JSON values for a policy's file."""
        return {key: getattr(self, name) for key, name in IN_FILES.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Layout":
        """Make the layout from the values of to_dict."""
        return cls(**{name: values[key] for key, name in IN_FILES.items()})

    def sector(self, bearing: float, width: float) -> Ints:
        """Return the indices of the beams within width / 2 of a bearing [rad]."""
        angles = self.angle_min + self.step * np.arange(self.beams)
        return np.flatnonzero(np.abs((angles - bearing + math.pi) % TURN_RAD - math.pi) <= 0.5 * width)

    def resample(self, ranges: Any, angle_min: float, angle_increment: float) -> Array32:
        """Return a scan resampled to this layout, (beams,) float32 [m]. A scan with the same geometry is unchanged.

        Each beam of the layout is a sector of `step` radians. It takes the smallest range in the sector, so that no
        obstacle is lost. A sector between two beams of a coarser scan takes the range of the beam nearer in angle. By
        REP 117 -inf (too near) is smaller than every range and +inf (no return) is larger. NaN (no measurement) remains
        only if a sector has no other value. Ranges of 0, which older drivers use for no measurement, count as NaN.

        Args:
            ranges: (n,) [m].
            angle_min: Direction of the first range [rad], 0 straight ahead, positive to the left.
            angle_increment: Angle from one range to the next [rad]; negative if the scanner turns clockwise.

        Raises:
            ObservationError: The scan does not cover the layout, is coarser than COARSEST_RAD, or has no geometry.
        """
        measured: Array32 = np.asarray(ranges, dtype=np.float32)
        zero = measured == 0.0
        if zero.any():  # Zeros must be replaced before the minimum is taken.
            measured = np.where(zero, np.float32(np.nan), measured)
        source, starts = _sectors(self, len(measured), float(angle_min), float(angle_increment))
        return np.fmin.reduceat(measured[source], starts) if len(source) else measured


@lru_cache(maxsize=32)
def _sectors(layout: Layout, count: int, first: float, step: float) -> Tuple[Ints, Ints]:
    """Return the indices of the scan's ranges in each of the layout's sectors.

    Returns:
        (source, starts): beam i takes source[starts[i] : starts[i + 1]]. Both are empty if the geometry is the same.
    """
    if count < 2 or not (math.isfinite(first) and math.isfinite(step)) or step == 0.0:
        scan = f"scan has {count} beams from {first:g} rad every {step:g} rad"
        raise ObservationError(f"{scan}, no geometry: check the laser's driver")
    if abs(step) > COARSEST_RAD:
        remedy = f"the limit is {COARSEST_RAD:.3f}: use a finer scanner or setting"
        raise ObservationError(f"scan has a beam every {abs(step):.3f} rad, {remedy}")
    last, half = first + step * (count - 1), 0.5 * layout.step
    if count == layout.beams and abs(first - layout.angle_min) < half and abs(last - layout.angle_max) < half:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # The layout may lie in another turn than the scan: the ranges are repeated over five turns, sorted by direction.
    turns = TURN_RAD * np.arange(-2, 3)
    angles = (first + step * np.arange(count) + turns[:, None]).ravel()
    order = np.argsort(angles, kind="stable")
    angles, source = angles[order], np.tile(np.arange(count), len(turns))[order]
    middles = layout.angle_min + layout.step * np.arange(layout.beams)
    right = np.clip(np.searchsorted(angles, middles), 1, len(angles) - 1)
    nearest = right - (middles - angles[right - 1] <= angles[right] - middles)
    covered = np.abs(angles[nearest] - middles) <= 0.5 * abs(step) + ANGLE_TOLERANCE_RAD
    if not covered.all():
        covers = f"scan of {count} beams covers {min(first, last):.3f} to {max(first, last):.3f} rad"
        raise ObservationError(f"{covers}: the policy needs {layout.angle_min:.3f} to {layout.angle_max:.3f}")
    begins, ends = (np.searchsorted(angles, middles + offset) for offset in (-half, half))
    empty = begins == ends
    begins, ends = np.where(empty, nearest, begins), np.where(empty, nearest + 1, ends)
    starts = np.concatenate([[0], np.cumsum(ends - begins)[:-1]])
    return np.concatenate([source[begin:end] for begin, end in zip(begins, ends)]), starts
