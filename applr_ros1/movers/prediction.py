"""Places where moving obstacles will be, as marks for the costmaps: the points of one more observation source.

Each mover's disc is carried on with its present velocity. Marked is what the laser would see of the discs then, where
they lie before what it sees now: there its own rays clear, so that no mark outlasts what it stands for. Called with
each scan by the movers node and by the training environment.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.common.scan import LaserScan, SensorCloud, beam_directions, project
from applr_ros1.movers.tracker import Movers, MoverTracker
from applr_ros1.robots import Robot

STEP_S = 0.15  # s between two places of a disc
HORIZON_S = 1.0  # s up to which discs are carried on
CLEARED_S = 3.0  # s after the last mover for which beams without return clear
FAR_M = 100.0  # m at which they end: beyond every obstacle_range, so that nothing is marked there
ROOM_M = 0.19  # m between the robot's circumscribed circle and marked discs; the Jackal's, others' in proportion


class Prediction:
    """Marks what moves in the scans of a robot.

    Attributes:
        movers: what the tracker made of the newest scan.
        marks: (n, 3) float32 [m], where they will be, in the frame of that scan's pose.
        room: least distance [m] of a marked disc from the middle of the robot. What is nearer would only block it.
    """

    def __init__(self, robot: Robot):
        self._tracker = MoverTracker.of(robot)
        self._laser = inverse(robot.laser.pose)  # the robot's pose in the laser's frame
        (length, width, _), (ahead, aside) = robot.body.size, robot.body.centre
        self.room = math.hypot(length / 2 + abs(ahead), width / 2 + abs(aside)) + ROOM_M * robot.world_scale
        self.reset()

    def reset(self) -> None:
        """Begin anew: the tracker has seen nothing yet."""
        self._tracker.reset()
        self._until = -math.inf
        self.movers = Movers(*(np.empty(0) for _ in Movers._fields))
        self.marks = np.empty((0, 3), np.float32)

    def add_scan(self, scan: LaserScan) -> SensorCloud:
        """Take a scan; return what it adds to the costmaps, in its pose's frame; no point where nothing moves, or did.

        The points are the marks and, for CLEARED_S, the ends of beams without return, so that there, too, marks go.
        """
        self.movers = self._tracker.update(scan)
        robot, points = compose(scan.sensor_pose, self._laser), [np.empty((0, 3), np.float32)]
        for time in np.arange(STEP_S, HORIZON_S + 1e-9, STEP_S) if len(self.movers.x) else ():
            points.append(project(replace(scan, ranges=self._seen(scan, robot, time))).points)
        self.marks = np.concatenate(points)
        if len(self.movers.x):
            self._until = scan.stamp + CLEARED_S
        points = [self.marks]
        if scan.stamp < self._until:
            beams = np.where(scan.ranges >= scan.range_max, np.float32(FAR_M), np.float32(np.inf))
            points.append(project(replace(scan, ranges=beams, range_max=2.0 * FAR_M)).points)
        x, y, _ = scan.sensor_pose
        origin = (x, y, scan.sensor_height) if scan.origin is None else scan.origin
        return SensorCloud(scan.stamp, np.concatenate(points), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), origin)

    def _seen(self, scan, robot, time) -> np.ndarray:
        """Return the ranges (beams,) float32 [m] of discs that beams meet in `time` [s] before what they meet now."""
        movers, beams = self.movers, beam_directions(scan.angle_min, scan.angle_increment, len(scan.ranges))
        x, y = movers.x + time * movers.vx, movers.y + time * movers.vy
        clear = np.hypot(x - robot[0], y - robot[1]) > movers.radius + self.room
        places = np.stack(transform_point(inverse(scan.sensor_pose), x[clear], y[clear]))
        along = beams @ places
        chord = movers.radius[clear] ** 2 - (places**2).sum(axis=0) + along**2
        entry = along - np.sqrt(np.maximum(chord, 0.0))
        nearest = np.where((chord > 0.0) & (along > 0.0), entry, np.inf).min(axis=1, initial=np.inf)
        return np.where(nearest < scan.ranges, nearest, np.inf).astype(np.float32)
