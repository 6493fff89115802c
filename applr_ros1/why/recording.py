"""Recording: a drive with every column that a replay needs, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist, compose
from applr_ros1.common.paths import step_lengths
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import Commands, Drive, Motion, Plans, Scans
from applr_ros1.robots import Robot

NEAR_GOAL_M = 2.0  # distance of the last pose from the plan's end below which this is the goal [m]
NEXT_GOAL_M = 1.0  # distance between the ends of two routes to different goals [m, for the Jackal]


class Replayable(NamedTuple):
    """Columns of a drive that can be replayed."""

    planned: Commands
    odometry: Motion
    scans: Scans
    plans: Plans


class PursuedGoal(NamedTuple):
    """Goal that a robot pursued.

    Attributes:
        pose: (x, y, yaw) [m, m, rad] in the odometry frame.
        begin: Time of its first route [s]; -inf for the first goal of a drive.
        end: Time of the first route to the next goal [s]; inf for the last one.
    """

    pose: Pose
    begin: float
    end: float


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

    def measured(self, odometry_row: int) -> Tuple[Pose, Twist]:
        """Return pose and velocity that the planner was given with an odometry message."""
        x, y, yaw = self.odometry.pose[odometry_row].tolist()
        v, w = self.planner_twist[odometry_row].tolist()
        return (x, y, yaw), (v, w)

    def scan(self, scan_row: int) -> LaserScan:
        """Return a scan at the laser's place in the odometry frame at the time of its stamp."""
        robot_pose = self.odometry.pose_at(self.scans.stamp[scan_row])
        sensor_pose = compose(robot_pose, self.laser_pose)
        return self.scans.scan(scan_row, 0.0, sensor_pose, self.robot.laser)

    def goal_at(self, time: float) -> Optional[PursuedGoal]:
        """Return the goal that the robot pursued at a time [s], or None if it is unknown.

        An application may send a goal again and again: goals at one place are one.
        """
        times, poses = self._goals()
        if not poses:
            return None
        next_goal_m = NEXT_GOAL_M * self.robot.world_scale
        steps = step_lengths(np.array(poses))
        later_rows = (np.flatnonzero(steps > next_goal_m) + 1).tolist()
        # The first route comes a moment after the goal.
        current_row = max(int(np.searchsorted(times, time, side="right")) - 1, 0)
        number = int(np.searchsorted(later_rows, current_row, side="right"))
        # Goal `number` is pursued from one change of the goal to the next one.
        changes = [-np.inf, *(times[row] for row in later_rows), np.inf]
        last_rows = [*(row - 1 for row in later_rows), -1]
        return PursuedGoal(poses[last_rows[number]], changes[number], changes[number + 1])

    def _goals(self) -> Tuple[List[float], List[Pose]]:
        """Return times [s] and goals: ends of routes, or what was sent, or the end of a plan."""
        drive = self.drive
        if drive.routes is not None:
            times, route_ends = drive.routes.ends
            if route_ends:
                return times, route_ends
        # Goals are sent in any frame, often that of a map.
        sent_goals = [sent for sent in drive.sent if sent.frame == drive.frame]
        if sent_goals:
            return [sent.time for sent in sent_goals], [sent.pose for sent in sent_goals]
        times, last_poses = self.plans.ends
        if last_poses:
            # The followed part of a plan ends at the goal only near it.
            end_x, end_y, _ = last_poses[-1]
            x, y, _ = self.odometry.pose[-1].tolist()
            if np.hypot(end_x - x, end_y - y) <= NEAR_GOAL_M:
                return times[-1:], last_poses[-1:]
        return [], []
