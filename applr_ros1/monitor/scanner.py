"""Whether a scanner can be believed: geometry, blindness, frozen images. CollisionMonitor asks for every scan."""

import math

import numpy as np

MAX_BEAMS = 100_000
BLIND_SHARE = 0.95  # of the beams measuring nothing at all (NaN, -inf, under range_min): the scanner is blind
ENOUGH = 5  # beams with a hit that a scan needs before its sudden emptiness counts as a fault
STILL_VISIBLE = 0.9  # share of range_max within which an obstacle of an earlier scan must still return a beam
FROZEN_SCANS = 5  # equal images in a row ...
FROZEN_DISTANCE, FROZEN_TURN = 0.03, 0.03  # ... while the robot moved by more than this [m, rad]
REPEATED = 0.005  # [m, rad]: an equal image after a motion of more than this is not news


class ScannerCheck:
    """Remembers just enough of the earlier scans to tell a working scanner from a broken one."""

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets earlier scans, for instance after the odometry was reset."""
        self._hits = np.zeros((0, 2))  # of the last scan that had any, in the odometry frame
        self._forget_image()

    def fault(self, scan, pose):
        """What is wrong with a scan, in one line, or "" for one to be believed.

        Args:
            scan: planner.costmap.scan.LaserScan in the odometry frame.
            pose: robot's (x, y, yaw) in that frame when it was measured.
        """
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
            return self._emptiness(scan)
        self._remember(scan, ranges, hits)
        return self._freezing(ranges, pose)

    def _forget_image(self):
        self._image = None
        self._equal, self._since = 0, (0.0, 0.0, 0.0)
        self.repeats = False  # whether the newest scan shows what the one before showed, though the robot moved

    def _emptiness(self, scan):
        """A scan without any hit is a fault where obstacles of an earlier scan would have to be in range."""
        dx, dy = self._hits[:, 0] - scan.sensor_pose[0], self._hits[:, 1] - scan.sensor_pose[1]
        bearing = np.arctan2(dy, dx) - scan.sensor_pose[2] - scan.angle_min
        span = scan.angle_increment * (len(scan.ranges) - 1)
        turned = np.mod(bearing * np.sign(span), 2.0 * math.pi)
        visible = (turned <= abs(span)) & (np.hypot(dx, dy) < STILL_VISIBLE * scan.range_max)
        if np.count_nonzero(visible) < ENOUGH:
            return ""
        return f"the scanner sees nothing where it saw {np.count_nonzero(visible)} obstacle points before"

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
