"""Makes the columns of a recorded drive fit on each other, as the planner saw them.

As in C++, the pose is tf's and the velocity that of the odometry topic, the laser is where tf has
it, and the local planner follows its cut of the global planner's latest plan. Its plan is in the
frame of the local costmap, in which the drive is replayed. What cannot be laid over another is
refused; what differs from the robot's files is said in a note.
"""

from __future__ import annotations

from dataclasses import replace
from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from applr_ros1.common.angles import Pose, inverse
from applr_ros1.common.arrays import nearest_rows
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import distances
from applr_ros1.common.scan import from_above
from applr_ros1.drives.clocks import clocks_differ, one_clock, placed_late
from applr_ros1.drives.drive import (
    Commands,
    Drive,
    DriveError,
    Goal,
    Motion,
    Plans,
    Scans,
    with_full_speed,
)
from applr_ros1.drives.frames import FrameTree
from applr_ros1.drives.places import PlacedBase, RouteFrame, apart, places_of
from applr_ros1.monitor.recorded_twists import checked_twists
from applr_ros1.planner.plan_cut import cut_plan, transformed
from applr_ros1.robots import Robot
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import RerunPlanner

# Difference from which on a place in tf is another one: of a pose by odometry, and of a laser.
POSE_OFF_M = 0.02
POSE_OFF_RAD = 0.02
LASER_OFF_M = 0.01
LASER_OFF_RAD = 0.01
CYCLE_S = 0.1  # longest time from the beginning of a cycle to its command [s]
STATUS_S = 0.3  # longest time between the sending of a goal and its first status (5 Hz) [s]
OFF_ROUTE_M = 0.3  # distance from which on a followed plan ends beside a global one [m]
GIVE_ROBOT = "give the robot that drove as --robot"
TF = "/tf and /tf_static"
TILTED = 0.996  # cosine of the tilt from which on a laser is not level (5 degrees)


class Fittable(NamedTuple):
    """Columns of a drive that are made to fit on each other."""

    planned: Commands
    odometry: Motion
    scans: Scans


class PlacedLaser(NamedTuple):
    """Scans of an upright laser, its place (x, y, yaw) [m, m, rad] on the robot, and notes."""

    scans: Scans
    pose: Pose
    notes: List[str]


class Noted(NamedTuple):
    """Motion of the robot, and notes about it."""

    motion: Motion
    notes: List[str]


def fitted(drive: Drive, planner: RerunPlanner, robot: Robot) -> Recording:
    """Return the recording of a drive, all columns in the frame of the local costmap.

    Args:
        drive: A drive as it was read, with odometry and scans.
        planner: Planner of the robot, which cuts the global planner's plans.
        robot: Robot that drove.

    Raises:
        ApplrError: Frames differ, and tf does not connect them.
    """
    # What is there, and where: each column is asked for once, and tf.
    drive = without_prefix(drive, robot)
    for column in ("odometry", "plans" if drive.plans else "routes"):
        _only_frame(drive, column)
    odometry_frame = drive.frame
    # The plans that were followed are in the frame of the local costmap.
    plan_frames = drive.frames.get("plans") or [odometry_frame]
    drive = replace(drive, frame=plan_frames[0])
    planned, odometry, scans = drive.require(Fittable)
    places = places_of(drive, planned, odometry, robot.frames.base)

    # Each column as the planner saw it
    laser = placed_laser(drive, scans, robot)
    if drive.frame != odometry_frame and not places.is_framed:
        raise _unconnected(drive.frame, odometry_frame)
    moved = _with_poses(odometry, places.base)
    late_notes = placed_late(laser.scans, moved.motion)
    driven = with_velocities(moved.motion)
    notes = [*drive.notes, *laser.notes, *moved.notes, *late_notes, *driven.notes]
    routes = _routes_in_frame(drive, places.routes)
    if drive.plans and routes:
        routes = followed_routes(routes, drive.plans)
    plans = plans_of(drive, planned, driven.motion, places.routes, planner)
    drive = replace(
        drive, odometry=driven.motion, scans=laser.scans, plans=plans, routes=routes, notes=notes
    )
    # Whatever moved the robot, its planner was given the velocities of the topic.
    return replace(
        Recording.of(drive, robot), laser_pose=laser.pose, planner_twist=moved.motion.twist
    )


# -- frames ----------------------------------------------------------------------------------------
def without_prefix(drive: Drive, robot: Robot) -> Drive:
    """Return a drive without the prefix of its frames, such as robot1/ (tf_prefix) or robot1_."""
    laser_frame = drive.frames["scans"][0]
    prefix = "".join(laser_frame.rpartition("/")[:2])
    if not prefix and laser_frame.endswith(f"_{robot.laser.frame}"):
        prefix = laser_frame[: -len(robot.laser.frame)]
    # Plans may be in a map frame that several robots share, which has no prefix.
    robot_frames = (*drive.frames["odometry"], *drive.frames["scans"])
    if not all(frame_name.startswith(prefix) for frame_name in robot_frames):
        return drive

    def without(frame_name: str) -> str:
        return frame_name[len(prefix) :] if frame_name.startswith(prefix) else frame_name

    def shortened(names: List[str]) -> List[str]:
        return list(map(without, names))

    frames_of = {}
    for column, frame_names in drive.frames.items():
        frames_of[column] = shortened(frame_names)
    transforms = drive.transforms
    if transforms is not None:
        transforms = replace(
            transforms,
            parent=shortened(transforms.parent),
            child=shortened(transforms.child),
        )
    return replace(drive, frame=without(drive.frame), frames=frames_of, transforms=transforms)


def _only_frame(drive: Drive, column: str) -> str:
    """Return the frame of a column's messages. Raise ApplrError if they are in several frames."""
    frames = drive.frames[column]
    if len(frames) > 1:
        raise ApplrError(f"{column} in {' and in '.join(frames)}: they must be in one frame")
    return frames[0]


def _unconnected(frame: str, odometry_frame: str) -> ApplrError:
    """Return the error of plans in a frame that tf does not connect with the odometry's."""
    return ApplrError(f"the plan is in {frame}, the odometry in {odometry_frame}: record {TF}")


# -- laser -----------------------------------------------------------------------------------------
def placed_laser(drive: Drive, scans: Scans, robot: Robot) -> PlacedLaser:
    """Return the laser where tf has it, if it does, with the scans of one upside down turned.

    Args:
        drive: A drive whose frames have no prefix.
        scans: Its scans.
        robot: Robot that drove.

    Raises:
        ApplrError: The scans are in several frames, or those of a laser that neither robot.yaml nor
            tf knows.
    """
    frame = _only_frame(drive, "scans")
    in_tf = FrameTree(drive.transforms).place(robot.frames.base, frame, scans.stamp[:1])
    if in_tf is None:
        if frame != robot.laser.frame:
            differs = f"scans in {frame}, {robot.name} has {robot.laser.frame}"
            remedy = "give the robot that drove, or the topic of its scans, or record"
            raise ApplrError(f"{differs}: {remedy} {TF} with {robot.frames.base}")
        return PlacedLaser(scans, robot.laser.pose, [])
    # The laser's x axis gives its heading, also upside down; its z axis shows how it is mounted.
    laser_x, laser_y, laser_yaw = in_tf.planar[0].tolist()
    upright = float(in_tf.rotation.as_matrix()[0, 2, 2])
    notes = []
    if upright < 0.0:
        scans = _mirrored(scans)
        notes.append("the laser is mounted upside down (tf): its beams are taken in reverse")
    if abs(upright) < TILTED:
        degrees = np.degrees(np.arccos(abs(upright)))
        notes.append(f"tf tilts the laser by {degrees:.0f} degrees: it is taken as level")
    known_x, known_y, known_yaw = known_pose = robot.laser.pose
    off = apart(in_tf.planar, np.array([known_pose]))
    if off.distance <= LASER_OFF_M and off.angle <= LASER_OFF_RAD:
        return PlacedLaser(scans, known_pose, notes)
    notes.append(
        f"tf has the laser at ({laser_x:.2f}, {laser_y:.2f}) m, {laser_yaw:.2f} rad, "
        f"robot.yaml at ({known_x:.2f}, {known_y:.2f}) m, {known_yaw:.2f} rad: "
        "tf's place is taken"
    )
    return PlacedLaser(scans, (laser_x, laser_y, laser_yaw), notes)


def _mirrored(scans: Scans) -> Scans:
    """Return the scans of a laser upside down as those of an upright one."""
    mirrored_fans = scans.fan.copy()
    mirrored_ranges = []
    for row, ranges in enumerate(scans.ranges):
        first_angle, increment = scans.fan[row, :2]
        upright_ranges, mirrored_fans[row, 0] = from_above(ranges, first_angle, increment)
        mirrored_ranges.append(upright_ranges)
    return replace(scans, fan=mirrored_fans, ranges=mirrored_ranges)


# -- poses -----------------------------------------------------------------------------------------
def _with_poses(odometry: Motion, in_tf: Optional[PlacedBase]) -> Noted:
    """Return the odometry with the poses of tf, if it has them."""
    notes: List[str] = []
    if in_tf is None:
        return Noted(odometry, notes)
    odometry = replace(odometry, stamp=odometry.stamp - in_tf.later)
    joined = _joined(odometry, in_tf.link.time, in_tf.link.stamp, in_tf.by_link)
    if in_tf.later:
        problem = clocks_differ("the odometry is", in_tf.later, "tf")
        notes.append(f"{problem}; {one_clock('base')}")
    off = in_tf.from_topic
    if off is not None and (off.distance > POSE_OFF_M or off.angle > POSE_OFF_RAD):
        notes.append(
            f"the odometry topic is not what tf shows: up to {off.distance:.2f} m and "
            f"{off.angle:.2f} rad apart; poses are tf's, velocities the topic's"
        )
    return Noted(joined, notes)


def _joined(motion: Motion, times: np.ndarray, stamps: np.ndarray, poses: np.ndarray) -> Motion:
    """Return the velocities of a motion with other poses (n, 3), recorded at `times` for `stamps`.

    The planner takes the latest message of each. So a row is a message of the more frequent one,
    with the message of the other whose stamp is nearest; nothing is interpolated.
    """
    # Two of one rate may differ by some messages at the ends.
    if len(stamps) > 1.2 * len(motion):
        nearest_messages = nearest_rows(motion.stamp, stamps)
        twists = motion.twist[nearest_messages]
        sideways = motion.sideways[nearest_messages]
        return Motion(np.maximum.accumulate(times), stamps, poses, twists, sideways)
    nearest_messages = nearest_rows(stamps, motion.stamp)
    return replace(motion, stamp=stamps[nearest_messages], pose=poses[nearest_messages])


# -- velocities ------------------------------------------------------------------------------------
def with_velocities(motion: Motion) -> Noted:
    """Return a motion with its full speed, by its poses if its own velocities are left at 0."""
    checked = checked_twists(motion.stamp, motion.pose, motion.twist)
    if checked.problem:
        return Noted(replace(motion, twist=checked.twist), [checked.problem])
    return Noted(with_full_speed(motion), [])


# -- plans -----------------------------------------------------------------------------------------
def plans_of(
    drive: Drive,
    planned: Commands,
    odometry: Motion,
    route_frame: Optional[RouteFrame],
    planner: RerunPlanner,
) -> Plans:
    """Return the plans that were followed, or the parts of the global planner's that may have been.

    DWAPlannerROS publishes empty plans as long as it finds no command.

    Args:
        drive: The drive, with one of both.
        planned: Its commands of the planner.
        odometry: Its odometry.
        route_frame: Frame of the global planner's plans, as tf says (places.Places).
        planner: Planner of the robot.

    Raises:
        ApplrError: The plans are in another frame, and tf does not connect it with the odometry's.
    """
    plans = drive.plans
    routes = drive.routes
    if plans and (not routes or any(map(len, plans.path))):
        return plans
    if not routes:
        raise DriveError(f"{drive.name}: it has no routes")
    (plan_frame,) = drive.frames["routes"]
    origins: Optional[np.ndarray] = None
    if plan_frame != drive.frame:
        if route_frame is None:
            raise _unconnected(plan_frame, drive.frame)
        origins = route_frame.at_commands
    return followed_plans(routes, planned, odometry, drive.goals, origins, planner)


def followed_plans(
    routes: Plans,
    planned: Commands,
    odometry: Motion,
    goals: Sequence[Goal],
    origins: Optional[np.ndarray],
    planner: RerunPlanner,
) -> Plans:
    """Return the plan that the local planner has in the cycle of each command.

    It is the global planner's latest, in the odometry frame, without the points that were pruned in
    earlier cycles. The planner cuts and prunes it again at the pose of its cycle. A plan that came
    during the cycle may be too late for it: the one before then stands in a row of the same time.

    Args:
        routes: Plans of the global planner.
        planned: Commands of the planner.
        odometry: Motion of the robot.
        goals: Goals that were pursued; empty if nobody knows.
        origins: (n, 3) pose of the odometry frame in that of the plans at each command; None if
            both are the same.
        planner: Planner of the robot.
    """
    followed_times: List[float] = []
    followed_paths: List[np.ndarray] = []
    route_row = -1
    # What is left of the latest plan, and what was left of the one before it
    stored_plan = np.zeros((0, 3))
    previous_plan = stored_plan
    for cycle_row, command_time in enumerate(planned.time.tolist()):
        if routes.latest(command_time) != route_row:
            route_row = routes.latest(command_time)
            previous_plan = stored_plan
            stored_plan = routes.path[route_row]
        odometry_row = odometry.latest(command_time)
        if route_row < 0 or odometry_row < 0:
            continue
        if not len(stored_plan) or not _has_goal(goals, command_time):
            continue
        choices = [stored_plan]
        if len(previous_plan) and command_time - routes.time[route_row] < CYCLE_S:
            choices.insert(0, previous_plan)
        # Frames move in each other, so that a stored plan is transformed anew in each cycle.
        if origins is not None:
            choices = [_seen_from(origins[cycle_row], choice) for choice in choices]
        followed_times += [command_time] * len(choices)
        followed_paths += choices
        x, y, _ = odometry.pose[odometry_row].tolist()
        _, dropped_count = cut_plan(choices[-1], x, y, planner.cut_radius, planner.prunes)
        stored_plan = stored_plan[dropped_count:]
    return Plans(np.array(followed_times), followed_paths)


def _routes_in_frame(drive: Drive, route_frame: Optional[RouteFrame]) -> Optional[Plans]:
    """Return the global planner's plans in the drive's frame, or None if tf lacks it."""
    routes = drive.routes
    if routes is None or drive.frames["routes"][0] == drive.frame:
        return routes
    if route_frame is None:
        return None
    paths = []
    for route, origin in zip(routes.path, route_frame.at_routes):
        paths.append(_seen_from(origin, route))
    return Plans(routes.time, paths)


def followed_routes(routes: Plans, plans: Plans) -> Plans:
    """Return the plans of the global planner without those that were not followed.

    It publishes what somebody else asks it for (make_plan), too: that leads elsewhere. The next
    plan that is followed lies on move_base's own.
    """
    followed_times, followed_ends = plans.ends
    own_times = []
    own_paths = []
    for time, route in zip(routes.time.tolist(), routes.path):
        followed_row = int(np.searchsorted(followed_times, time))
        if len(route) and followed_row < len(followed_times):
            end = np.array(followed_ends[followed_row][:2])
            if float(distances(route[:, :2], end).min()) > OFF_ROUTE_M:
                continue
        own_times.append(time)
        own_paths.append(route)
    return Plans(np.array(own_times), own_paths)


def _seen_from(origin: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return a path (n, 3) in the frame that lies at `origin` (3,) x, y [m], yaw [rad]."""
    x, y, yaw = origin.tolist()
    return transformed(path, inverse((x, y, yaw)))


def _has_goal(goals: Sequence[Goal], time: float) -> bool:
    """Return whether a goal was pursued at a time, or whether nobody knows."""
    if not goals:
        return True
    return any(goal.begin - STATUS_S <= time <= goal.end for goal in goals)
