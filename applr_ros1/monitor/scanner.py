"""Whether a scanner can be believed: geometry, blindness, frozen images, sectors. CollisionMonitor asks each time."""

import math

import numpy as np

MAX_BEAMS = 100_000
BLIND_SHARE = 0.95  # of the beams measuring nothing at all (NaN, -inf, under range_min): the scanner is blind
ENOUGH = 5  # beams with a hit that a scan needs before its sudden emptiness counts as a fault
STILL_VISIBLE = 0.9  # share of range_max within which an obstacle of an earlier scan must still return a beam
FROZEN_SCANS = 5  # equal images in a row ...
FROZEN_DISTANCE, FROZEN_TURN = 0.03, 0.03  # ... while the robot moved by more than this [m, rad]
SECTOR = math.pi / 4  # [rad]: neighbouring beams of at least so much that all at once return nothing ...
STOOD = 0.3  # ... where for this share of them something must stand, are not believed
REPEATED = 0.005  # [m, rad]: an equal image after a motion of more than this is not news


class ScannerCheck:
    """Remembers just enough of the earlier scans to tell a working scanner from a broken one.

    Attributes:
        repeats: whether the newest scan shows what the one before showed, though the robot moved.
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets earlier scans, for instance after the odometry was reset."""
        self._hits = np.zeros((0, 2))  # of the last scan that had any, in the odometry frame
        self._doubted = np.zeros(0, bool)  # beams that measured nothing where something must stand
        self._forget_image()

    def fault(self, scan):
        """What is wrong with a scan (planner.costmap.scan.LaserScan in the odometry frame) in one line, or ""."""
        problem = geometry_fault(scan)
        if problem:
            return problem
        ranges = np.asarray(scan.ranges, dtype=np.float32)
        blind = np.count_nonzero(np.isnan(ranges) | (ranges < scan.range_min))  # +inf measured that nothing is there
        if blind >= BLIND_SHARE * len(ranges):
            beams = f"{blind} of {len(ranges)} beams"
            return f"the scanner is blind: {beams} are NaN or nearer than range_min {scan.range_min:g} m"
        hits = (ranges >= scan.range_min) & (ranges < scan.range_max)
        if not hits.any():
            self._forget_image()
            self._doubted = np.zeros(len(ranges), bool)
            return self._emptiness(scan)
        self._doubt(scan, ranges)
        self._remember(scan, ranges, hits)
        return self._freezing(ranges, scan.sensor_pose)

    def believed(self, ranges):
        """The ranges of the newest scan, NaN for the beams of a sector that has failed until they return again."""
        return np.where(self._doubted, np.float32(np.nan), ranges) if self._doubted.any() else ranges

    def _forget_image(self):
        self._image = None
        self._equal, self._since = 0, (0.0, 0.0, 0.0)
        self.repeats = False

    def _emptiness(self, scan):
        """A scan without any hit is a fault where obstacles of an earlier scan would have to be in range."""
        count = len(self._expected(scan))
        return f"the scanner sees nothing where it saw {count} obstacle points before" if count >= ENOUGH else ""

    def _expected(self, scan):
        """Beams (k,) on which the hits of the last scan must lie in this one, unless what stood there has gone."""
        dx, dy = self._hits[:, 0] - scan.sensor_pose[0], self._hits[:, 1] - scan.sensor_pose[1]
        bearing = np.arctan2(dy, dx) - scan.sensor_pose[2] - scan.angle_min
        turned = np.mod(bearing * np.sign(scan.angle_increment), 2.0 * math.pi) / abs(scan.angle_increment)
        visible = (turned <= len(scan.ranges) - 1) & (np.hypot(dx, dy) < STILL_VISIBLE * scan.range_max)
        return np.rint(turned[visible]).astype(int)

    def _doubt(self, scan, ranges):
        """Finds wide sectors that return nothing from one scan to the next: nothing that stands there goes so fast."""
        nothing, n = ranges >= scan.range_max, len(ranges)
        self._doubted = nothing & self._doubted if len(self._doubted) == n else np.zeros(n, bool)
        full_turn = (n + 0.5) * abs(scan.angle_increment) >= 2.0 * math.pi
        first = int(np.argmin(nothing)) if full_turn else 0  # a sector may go on across the ends of a full turn
        order = (first + np.arange(n)) % n
        edges = np.flatnonzero(np.diff(nothing[order].astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        for begin, end in edges[np.ptp(edges, axis=1) * abs(scan.angle_increment) >= SECTOR]:
            sector = order[begin:end]
            if np.count_nonzero(np.isin(sector, self._expected(scan))) >= STOOD * len(sector):
                self._doubted[sector] = True

    def _remember(self, scan, ranges, hits):
        if np.count_nonzero(hits) < ENOUGH:
            return
        angles = scan.sensor_pose[2] + scan.angle_min + scan.angle_increment * np.flatnonzero(hits)
        self._hits = np.column_stack(
            (
                scan.sensor_pose[0] + ranges[hits] * np.cos(angles),
                scan.sensor_pose[1] + ranges[hits] * np.sin(angles),
            )
        )

    def _freezing(self, ranges, pose):
        if self._image is None or not np.array_equal(ranges, self._image, equal_nan=True):
            self._image, self._equal, self._since = ranges.copy(), 0, tuple(pose)
            self.repeats = False
            return ""
        self._equal += 1
        moved = math.hypot(pose[0] - self._since[0], pose[1] - self._since[1])
        turned = abs(math.remainder(pose[2] - self._since[2], 2.0 * math.pi))
        self.repeats = moved > REPEATED or turned > REPEATED
        if self._equal < FROZEN_SCANS or (moved < FROZEN_DISTANCE and turned < FROZEN_TURN):
            return ""
        return (
            f"the scanner is frozen: {self._equal + 1} equal images while the robot moved {moved:.2f} m and "
            f"{turned:.2f} rad"
        )


def geometry_fault(scan):
    """What is impossible about a scan's description, in one line, or ""."""
    count = np.size(scan.ranges)
    numbers = scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, *scan.sensor_pose, scan.stamp
    if not all(math.isfinite(value) for value in numbers):
        return "the scan's geometry, pose or stamp is not finite"
    if not 3 <= count <= MAX_BEAMS:
        return f"a scan of {count} beams: 3 to {MAX_BEAMS} are possible"
    if scan.angle_increment == 0.0 or abs(scan.angle_increment) * (count - 1) > 2.0 * math.pi + 0.02:
        return f"{count} beams {scan.angle_increment:g} rad apart are no planar scan"
    if not 0.0 <= scan.range_min < scan.range_max:
        return f"the scan's ranges are {scan.range_min:g} to {scan.range_max:g} m"
    return ""
