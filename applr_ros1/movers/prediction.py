"""Predicted obstacle points: future positions of moving obstacles as an additional observation source of the costmaps.

Each moving obstacle is a disc that keeps its current velocity. The predicted points are the points that the laser would
measure on the discs, if they are nearer than the current ranges. The rays of later scans clear this space, so that no
prediction stays in the costmap. The movers node and the training environment call Prediction.add_scan with each scan.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, transform_point
from applr_ros1.common.scan import LaserScan, SensorCloud, beam_directions, project
from applr_ros1.movers.tracker import Movers, MoverTracker
from applr_ros1.robots import Robot

STEP_S = 0.15  # interval between two predicted positions of a disc [s]
HORIZON_S = 1.0  # prediction horizon [s]
CLEARED_S = 3.0  # time for which beams without return clear the costmaps after the last moving obstacle is lost [s]
FAR_M = 100.0  # range of the end points of beams without return [m]; exceeds every obstacle_range, so they mark no cell
ROOM_M = 0.19  # gap between the Jackal's circumscribed circle and predicted discs [m]; scaled for other robots


class Prediction:
    """Predictor of obstacle points for one robot.

    Attributes:
        movers: moving obstacles in the latest scan.
        points: (n, 3) float32, predicted obstacle points in the frame of the latest scan's pose [m].
        room: minimum gap between a predicted disc and the robot's centre [m]. Nearer discs would only block the robot.
    """

    def __init__(self, robot: Robot):
        self._tracker = MoverTracker.of(robot)
        self._laser = inverse(robot.laser.pose)  # the robot's pose in the laser's frame
        (length, width, _), (ahead, aside) = robot.body.size, robot.body.centre
        self.room = (
            math.hypot(length / 2 + abs(ahead), width / 2 + abs(aside)) + ROOM_M * robot.world_scale
        )
        self.reset()

    def reset(self) -> None:
        """Forget all scans and moving obstacles."""
        self._tracker.reset()
        self._until = -math.inf
        self.movers = Movers(*(np.empty(0) for _ in Movers._fields))
        self.points = np.empty((0, 3), np.float32)

    def add_scan(self, scan: LaserScan) -> SensorCloud:
        """Track and predict with a scan, and return the points for the costmaps in the frame of the scan's pose.

        The points are the predicted obstacle points and, for CLEARED_S, the ends of beams without return, which clear
        old predictions. The cloud is empty if no obstacle has moved within this time.
        """
        self.movers = self._tracker.update(scan)
        robot, points = compose(scan.sensor_pose, self._laser), [np.empty((0, 3), np.float32)]
        for time in np.arange(STEP_S, HORIZON_S + 1e-9, STEP_S) if len(self.movers.x) else ():
            points.append(project(replace(scan, ranges=self._seen(scan, robot, time))).points)
        self.points = np.concatenate(points)
        if len(self.movers.x):
            self._until = scan.stamp + CLEARED_S
        points = [self.points]
        if scan.stamp < self._until:
            beams = np.where(scan.ranges >= scan.range_max, np.float32(FAR_M), np.float32(np.inf))
            points.append(project(replace(scan, ranges=beams, range_max=2.0 * FAR_M)).points)
        x, y, _ = scan.sensor_pose
        origin = (x, y, scan.sensor_height) if scan.origin is None else scan.origin
        return SensorCloud(
            scan.stamp, np.concatenate(points), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), origin
        )

    def _seen(self, scan: LaserScan, robot: Pose, time: float) -> np.ndarray:
        """Return the ranges (beams,) float32 [m] to the discs in `time` [s]; +inf if not nearer than the scan's."""
        movers, beams = (
            self.movers,
            beam_directions(scan.angle_min, scan.angle_increment, len(scan.ranges)),
        )
        x, y = movers.x + time * movers.vx, movers.y + time * movers.vy
        clear = np.hypot(x - robot[0], y - robot[1]) > movers.radius + self.room
        places = np.stack(transform_point(inverse(scan.sensor_pose), x[clear], y[clear]))
        along = beams @ places
        chord = movers.radius[clear] ** 2 - (places**2).sum(axis=0) + along**2
        entry = along - np.sqrt(np.maximum(chord, 0.0))
        nearest = np.where((chord > 0.0) & (along > 0.0), entry, np.inf).min(axis=1, initial=np.inf)
        return np.where(nearest < scan.ranges, nearest, np.inf).astype(np.float32)
