"""Recording: a drive with every column that a replay needs, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import Commands, Drive, Motion, Plans, Scans
from applr_ros1.planner.local_planner import Command
from applr_ros1.robots import Robot


class Replayable(NamedTuple):
    """Columns of a drive that can be replayed."""

    planned: Commands
    odometry: Motion
    scans: Scans
    plans: Plans


@dataclass(frozen=True)
class Recording:
    """Recorded drive that can be replayed. All its columns are in the frame of the local costmap.

    Attributes:
        drive: The drive, with the columns below and those that may be missing.
        robot: Robot that drove.
        planned: Commands of the planner.
        odometry: Motion by odometry.
        planner_twist: (n, 2) velocities that the planner was given with each row of the odometry.
        scans: Laser scans.
        laser_pose: Place (x, y, yaw) [m, m, rad] of the laser in the robot's frame.
        plans: Plans that were followed.
    """

    drive: Drive
    robot: Robot
    planned: Commands
    odometry: Motion
    planner_twist: np.ndarray
    scans: Scans
    laser_pose: Pose
    plans: Plans

    @classmethod
    def of(cls, drive: Drive, robot: Robot) -> Recording:
        """Return the recording of a drive whose columns fit on each other, as a simulated one.

        Raises:
            DriveError: The drive lacks commands, odometry, scans or plans.
        """
        columns = drive.require(Replayable)
        return cls(
            drive=drive,
            robot=robot,
            planned=columns.planned,
            odometry=columns.odometry,
            planner_twist=columns.odometry.twist,
            scans=columns.scans,
            laser_pose=robot.laser.pose,
            plans=columns.plans,
        )

    def measured(self, odometry_row: int) -> Tuple[Pose, Command]:
        """Return pose and velocity that the planner was given with an odometry message."""
        x, y, yaw = self.odometry.pose[odometry_row].tolist()
        v, w = self.planner_twist[odometry_row].tolist()
        return (x, y, yaw), (v, w)

    def scan(self, scan_row: int) -> LaserScan:
        """Return a scan at the laser's place in the odometry frame at the time of its stamp."""
        first_angle, increment, range_min, range_max = self.scans.fan[scan_row].tolist()
        robot_pose = self.odometry.pose_at(self.scans.stamp[scan_row])
        return LaserScan(
            stamp=0.0,
            angle_min=first_angle,
            angle_increment=increment,
            range_min=range_min,
            range_max=range_max,
            ranges=self.scans.ranges[scan_row],
            sensor_pose=compose(robot_pose, self.laser_pose),
            sensor_height=self.robot.laser.height,
        )
