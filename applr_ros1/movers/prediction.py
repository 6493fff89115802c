"""Predicted obstacle points: future positions of moving obstacles as a source of the costmaps.

Each moving obstacle is a disc that keeps its current velocity. The predicted points are the points
that the laser would measure on the discs, if they are nearer than the current ranges. The rays of
later scans clear this space, so that no prediction stays in the costmap. The movers node and the
training environment call Prediction.add_scan with each scan.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, transform_point
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan, SensorCloud, beam_directions, project
from applr_ros1.movers import tracks
from applr_ros1.movers.tracker import DISC_COLUMNS, MoverTracker
from applr_ros1.robots import Robot

STEP_S = 0.15  # interval between two predicted positions of a disc [s]
HORIZON_S = 1.0  # prediction horizon [s]
# Time for which beams without return clear the costmaps after the last moving obstacle is lost [s].
CLEARED_S = 3.0
# Range of the end points of beams without return [m]. It exceeds every obstacle_range, so that they
# mark no cell.
FAR_M = 100.0
# Gap between the Jackal's circumscribed circle and predicted discs [m]; scaled for other robots.
ROOM_M = 0.19


class Prediction:
    """Predictor of obstacle points for one robot.

    Args:
        robot: the robot.
        tracker: tracker of its scans, which a monitor beside may have updated before.

    Attributes:
        movers: moving obstacles in the latest scan.
        points: (n, 3) float32, predicted obstacle points in the frame of the costmap [m].
        room: minimum gap between a predicted disc and the robot's centre [m]. Nearer discs would
            only block the robot.
    """

    def __init__(self, robot: Robot, tracker: MoverTracker):
        self._tracker = tracker
        self._robot_in_laser = inverse(robot.laser.pose)  # the robot's pose in the laser's frame
        length, width, _ = robot.body.size
        centre_x, centre_y = robot.body.centre
        radius = math.hypot(length / 2 + abs(centre_x), width / 2 + abs(centre_y))
        self.room = radius + ROOM_M * robot.world_scale
        self.reset()

    def reset(self) -> None:
        """Forget all scans and moving obstacles."""
        self._tracker.reset()
        self._clears_until = -math.inf  # stamp until which beams without return clear [s]
        self.movers = self._tracker.movers
        self.points = np.empty((0, 3), np.float32)

    def add_scan(self, scan: LaserScan) -> SensorCloud:
        """Track and predict with a scan, and return the points for the costmaps.

        The points are the predicted obstacle points and, for CLEARED_S, the ends of beams without
        return, which clear old predictions. The cloud is in the frame of the costmap, and empty
        if no obstacle has moved within this time.
        """
        self.movers = self._tracker.update(scan)
        self.points = np.empty((0, 3), np.float32)
        if len(self.movers.x):
            self.points = self._predicted(scan)
            self._clears_until = scan.stamp + CLEARED_S
        points = self.points
        if scan.stamp < self._clears_until:
            points = np.concatenate((points, _ends_without_return(scan)))
        origin = scan.origin
        if origin is None:
            x, y, _ = scan.sensor_pose
            origin = (x, y, scan.sensor_height)
        # The points are in the costmap's frame already.
        no_rotation = (0.0, 0.0, 0.0, 1.0)
        no_offset = (0.0, 0.0, 0.0)
        return SensorCloud(scan.stamp, points, no_offset, no_rotation, origin)

    def _predicted(self, scan: LaserScan) -> Array32:
        """Return the predicted points (n, 3) float32 [m] in the frame of the costmap."""
        robot_pose = compose(scan.sensor_pose, self._robot_in_laser)
        points = []
        for prediction_time in np.arange(STEP_S, HORIZON_S + 1e-9, STEP_S):
            ranges = self._ranges_to_discs(scan, robot_pose, prediction_time)
            points.append(project(replace(scan, ranges=ranges)).points)
        return np.concatenate(points)

    def _ranges_to_discs(self, scan: LaserScan, robot: Pose, time: float) -> Array32:
        """Return the ranges (beams,) float32 [m] to the discs in `time` [s].

        They are +inf unless they are nearer than the scan's. Discs too near to the robot are left
        out.
        """
        movers = self.movers
        x = movers.x + time * movers.vx
        y = movers.y + time * movers.vy
        robot_x, robot_y, _ = robot
        is_clear = np.hypot(x - robot_x, y - robot_y) > movers.radius + self.room
        to_laser = inverse(scan.sensor_pose)
        centre_x, centre_y = transform_point(to_laser, x[is_clear], y[is_clear])
        discs = np.column_stack([centre_x, centre_y, movers.radius[is_clear]])
        directions = beam_directions(scan.angle_min, scan.angle_increment, len(scan.ranges))
        return _nearer_ranges(directions, discs, scan.distances)


@kernel
def _nearer_ranges(directions: Array, discs: Array, distances: Array32) -> Array32:
    """Return the ranges (n,) [m] at which beams meet discs, +inf if not nearer than `distances`.

    Args:
        directions: (n, 2) cosine and sine of each beam.
        discs: (k, 3) x, y and radius in the laser's frame [m].
        distances: (n,) LaserScan.distances [m].
    """
    ranges = np.empty(distances.shape[0], np.float32)
    for beam in range(distances.shape[0]):
        nearest = np.inf
        for disc in range(discs.shape[0]):
            x = discs[disc, 0]
            y = discs[disc, 1]
            radius = discs[disc, 2]
            # Distance along the beam of the point nearest to the centre, and square of half the
            # chord that the beam cuts off the disc, which is negative if it misses the disc
            along = directions[beam, 0] * x + directions[beam, 1] * y
            half_chord2 = radius * radius - (x * x + y * y) + along * along
            if half_chord2 > 0.0 and along > 0.0:
                nearest = min(nearest, along - math.sqrt(half_chord2))
        ranges[beam] = nearest if nearest < distances[beam] else np.inf
    return ranges


def _ends_without_return(scan: LaserScan) -> Array32:
    """Return the ends (n, 3) float32 [m] of the beams without return, at FAR_M."""
    has_no_return = np.isposinf(scan.distances)
    ranges = np.where(has_no_return, np.float32(FAR_M), np.float32(np.inf))
    return project(replace(scan, ranges=ranges, range_max=2.0 * FAR_M)).points


def warm_up() -> None:
    """Compile or load all kernels, most by a tracker that sees a disc approach in two scans."""
    tracker = MoverTracker(1.0, 1.0, 0.1)
    is_on_disc = abs(np.arange(41) - 20) < 8
    for stamp, distance in ((0.0, 2.0), (0.1, 1.9)):
        ranges = np.where(is_on_disc, distance, 5.0)
        tracker.update(LaserScan(stamp, -0.4, 0.02, 0.1, 10.0, ranges, (0.0, 0.0, 0.0)))
    tracks.join_legs(np.zeros((1, len(DISC_COLUMNS))))
    _nearer_ranges(np.zeros((1, 2)), np.zeros((1, 3)), np.zeros(1, np.float32))
