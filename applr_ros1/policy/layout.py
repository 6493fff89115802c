"""Layout of a policy's scan and local goal: beams, range cap, and lookahead distance.

The layout belongs to the policy's file, not to the laser. Any planar scan that covers the layout is
resampled to it, so that a policy also works with other scanners than in its training. The applr
node, the training environment and the bag reader use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Dict, Mapping, NamedTuple, Optional

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.arrays import Array, Array32, Ints, nearest_rows
from applr_ros1.common.errors import ApplrError

# Angle by which a scan may be narrower than the layout, on each side [rad]
ANGLE_TOLERANCE_RAD = 0.02
# Largest angle between two beams [rad]; a post of 0.15 m spans 4 degrees at 2 m.
COARSEST_RAD = math.radians(3.0)
TURN_RAD = 2.0 * math.pi  # full turn [rad]
FIELDS_IN_FILES = {  # names of a layout's fields by their keys in files
    "beams": "beams",
    "range_cap_m": "range_cap",
    "lookahead_m": "lookahead",
    "angle_min_rad": "angle_min",
    "angle_max_rad": "angle_max",
}
# Turns over which a scan is repeated, because a layout may lie in another one
TURNS = TURN_RAD * np.arange(-2, 3)


class ObservationError(ApplrError):
    """Error for a scan or plan from which no observation can be made. Its message is one line."""


@dataclass(frozen=True)
class Layout:
    """Layout of the scan and local goal in an observation.

    Attributes:
        beams: Number of evenly spaced sectors of the scan.
        angle_min: Direction of the first sector's centre [rad], 0 straight ahead, positive to the
            left.
        angle_max: Direction of the last sector's centre [rad]; larger than angle_min.
        range_cap: Range beyond which space counts as free [m].
        lookahead: Distance of the local goal [m]: the first point of the global plan farther away
            than this.
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

    @property
    def angles(self) -> Array:
        """Directions (beams,) of the centres of the sectors [rad]."""
        return self.angle_min + self.step * np.arange(self.beams, dtype=np.float64)

    def to_dict(self) -> Dict[str, Any]:
        """Return the layout as JSON values for a policy's file."""
        return {key: getattr(self, name) for key, name in FIELDS_IN_FILES.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Layout":
        """Make the layout from the values of to_dict."""
        return cls(**{name: values[key] for key, name in FIELDS_IN_FILES.items()})

    def sector(self, bearing: float, width: float) -> Ints:
        """Return the indices of the beams within width / 2 of a bearing [rad]."""
        # Differences of directions, wrapped: behind the robot, -pi and pi are the same.
        angle_offsets = normalize_angle_modulo(self.angles - bearing)
        return np.flatnonzero(np.abs(angle_offsets) <= 0.5 * width)

    def resample(self, ranges: Any, angle_min: float, angle_increment: float) -> Array32:
        """Return a scan resampled to this layout, (beams,) float32 [m].

        A scan with the same geometry is unchanged.

        Each beam of the layout is a sector of `step` radians. It takes the smallest range in the
        sector, so that no obstacle is lost. A sector between two beams of a coarser scan takes the
        range of the beam nearer in angle. By REP 117 -inf (too near) is smaller than every range
        and +inf (no return) is larger. NaN (no measurement) remains only if a sector has no other
        value.

        Args:
            ranges: (n,) LaserScan.distances [m].
            angle_min: Direction of the first range [rad], 0 straight ahead, positive to the left.
            angle_increment: Angle from one range to the next [rad]; negative if the scanner turns
                clockwise.

        Raises:
            ObservationError: The scan does not cover the layout, is coarser than COARSEST_RAD, or
                has no geometry.
        """
        distances = np.asarray(ranges, dtype=np.float32)
        sectors = _sectors(self, len(distances), float(angle_min), float(angle_increment))
        if sectors is None:
            return distances
        return np.fmin.reduceat(distances[sectors.source], sectors.starts)


class Sectors(NamedTuple):
    """Ranges of a scan in each sector of a layout: sector i has source[starts[i] : starts[i + 1]].

    Attributes:
        source: (k,) indices of the scan's ranges, by sector.
        starts: (beams,) index in `source` of the first range of each sector.
    """

    source: Ints
    starts: Ints


@lru_cache(maxsize=32)
def _sectors(layout: Layout, count: int, first: float, step: float) -> Optional[Sectors]:
    """Return the ranges of a scan in each sector of a layout, or None for the same geometry.

    Args:
        layout: The layout.
        count: Number of the scan's ranges.
        first: Direction of the first range [rad].
        step: Angle from one range to the next [rad].
    """
    _check_geometry(count, first, step)
    last = first + step * (count - 1)
    half_sector = 0.5 * layout.step
    begins_alike = abs(first - layout.angle_min) < half_sector
    ends_alike = abs(last - layout.angle_max) < half_sector
    if count == layout.beams and begins_alike and ends_alike:
        return None

    # The beams in order of their directions, repeated over all TURNS
    directions = first + step * np.arange(count)
    repeated_angles = (directions + TURNS[:, None]).ravel()
    order = np.argsort(repeated_angles, kind="stable")
    angles = repeated_angles[order]
    source = np.tile(np.arange(count), len(TURNS))[order]

    centres = layout.angles
    nearest_beams = nearest_rows(angles, centres)

    # A sector is covered if this beam lies within half a beam of its centre, up to the tolerance.
    largest_offset = 0.5 * abs(step) + ANGLE_TOLERANCE_RAD
    is_covered = np.abs(angles[nearest_beams] - centres) <= largest_offset
    if not is_covered.all():
        coverage = f"{min(first, last):.3f} to {max(first, last):.3f} rad"
        need = f"{layout.angle_min:.3f} to {layout.angle_max:.3f}"
        raise ObservationError(f"scan of {count} beams covers {coverage}: the policy needs {need}")

    # Sectors between two beams of a coarser scan are empty, and take the nearest beam.
    first_beams = np.searchsorted(angles, centres - half_sector)
    end_beams = np.searchsorted(angles, centres + half_sector)
    is_empty = first_beams == end_beams
    first_beams = np.where(is_empty, nearest_beams, first_beams)
    end_beams = np.where(is_empty, nearest_beams + 1, end_beams)

    # A sector's ranges start where those of the sectors before it end.
    beam_counts = end_beams - first_beams
    starts = np.cumsum(beam_counts) - beam_counts
    ranges = [source[begin:end] for begin, end in zip(first_beams, end_beams)]
    return Sectors(np.concatenate(ranges), starts)


def _check_geometry(count: int, first: float, step: float) -> None:
    """Raise ObservationError if a scan has no geometry, or too few beams for its angle."""
    is_finite = math.isfinite(first) and math.isfinite(step)
    if count < 2 or not is_finite or step == 0.0:
        scan = f"scan has {count} beams from {first:g} rad every {step:g} rad"
        raise ObservationError(f"{scan}, no geometry: check the laser's driver")
    if abs(step) > COARSEST_RAD:
        remedy = f"the limit is {COARSEST_RAD:.3f}: use a finer scanner or setting"
        raise ObservationError(f"scan has a beam every {abs(step):.3f} rad, {remedy}")
