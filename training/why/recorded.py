"""Reads a recorded drive for the replay, and makes its columns fit on each other.

As in C++, the pose is tf's and the velocity that of the odometry topic, the laser is where tf has
it, and the local planner follows its cut of the global planner's latest plan. Its plan is in the
frame of the local costmap, in which the drive is replayed. What cannot be laid over another is
refused; what differs from the robot's files is said in a note.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Iterator, List, Mapping, Optional, Set, Tuple

import numpy as np

from applr_ros1.common.angles import inverse, normalize_angle_modulo
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import distances
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive, Motion, Plans, Scans, nearest_rows
from applr_ros1.monitor.motion import PoseMotion
from applr_ros1.monitor.odometry_check import OdometryCheck
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.planner.plan_cut import cut_plan, half_size, transformed
from applr_ros1.robots import Robot
from training.bags.clocks import APART_S, clocks_differ, one_clock, scans_apart, stamped_later
from training.bags.names import missing, missing_plans, names_in
from training.bags.read import read, refused, topics_in
from training.bags.topics import BagOptions
from training.bags.transforms import Tree
from training.common.options import option
from training.env.episode import counting_cells

CHANNELS = (
    "scans",
    "odometry",
    "transforms",
    "commands",
    "planned",
    "changes",
    "plans",
    "routes",
    "recoveries",
    "decisions",
    "goals",
    "sent",
)
# Difference from which on a place in tf is another one: of a pose by odometry, and of a laser.
POSE_OFF_M = 0.02
POSE_OFF_RAD = 0.02
LASER_OFF_M = 0.01
LASER_OFF_RAD = 0.01
TF_BUFFER_S = 10.0  # time for which tf keeps transforms [s]
VELOCITY_SPAN_S = 0.5  # time over which a velocity is measured from poses [s]
CYCLE_S = 0.1  # longest time from the beginning of a cycle to its command [s]
STATUS_S = 0.3  # longest time between the sending of a goal and its first status (5 Hz) [s]
TILTED = 0.996  # cosine of the tilt from which on a laser is not level (5 degrees)


class RecordedOptions(BagOptions):
    """Options of a recorded drive."""

    move_base: str = option("", "Namespace of move_base in the bag. Default: that of its plans.")


def drive_of(path: Path, options: RecordedOptions) -> Drive:
    """Read the drive in a bag.

    Raises:
        BagError: The bag cannot be read, lacks odometry, scans, commands or plans, another robot or
            planner drove, or the frames of its messages do not fit.
    """
    robot = options.robot
    with refused(path):
        types = topics_in(path)
        names = _names(types, options)
        drive = read(path, robot, names, CHANNELS)
        if drive.planned is None:  # Without a monitor, the planner's commands reach the base.
            drive.planned = drive.commands
        _check_planner(drive, options)
        _check_columns(drive, robot, names, types)
        return fitted(drive, options)


def fitted(drive: Drive, options: RecordedOptions) -> Drive:
    """Return a drive whose poses, scans and plans are in one frame, that of the local costmap.

    Raises:
        ApplrError: Frames differ, and tf does not connect them.
    """
    robot = options.robot
    drive = _without_prefix(drive)
    tree = Tree(drive.transforms)
    for column in ("odometry", "scans", "plans" if drive.plans else "routes"):
        frames = drive.frames[column]
        if len(frames) > 1:
            raise ApplrError(f"{column} in {' and in '.join(frames)}: they must be in one frame")
    # The caller's drive keeps its columns and notes.
    drive = replace(drive, notes=list(drive.notes))
    _place_laser(drive, tree, options)
    # The plans that were followed are in the frame of the local costmap.
    for frame in drive.frames.get("plans", []):
        if frame != drive.frame:
            if tree.place(frame, robot.frames.base, np.zeros(1)) is None:
                raise _unconnected(frame, drive)
            drive.frame = frame
    _take_poses(drive, tree, robot)
    _compare_clocks(drive)
    _compare_velocities(drive)
    drive.plans = plans_of(drive, tree, robot)
    drive.routes = _routes_by_odometry(drive, tree)
    return drive


def _names(types: Mapping[str, str], options: RecordedOptions) -> TopicNames:
    """Return the topics of the drive in a bag; those that are options are not looked for."""
    return names_in(types, options.topics(), options.given_topics())


def _check_planner(drive: Drive, options: RecordedOptions) -> None:
    """Raise ApplrError if another local planner drove."""
    robot = options.robot
    if not drive.planners:
        return
    # A robot with a planner that nothing here replays need not be given.
    replayed_planners = list(map(namespace, LOCAL_PLANNERS))
    known_planners = [planner for planner in drive.planners if planner in replayed_planners]
    if not known_planners:
        drives_in_words = f"only drives of {' and '.join(replayed_planners)} are replayed"
        raise ApplrError(f"{drive.planners[0]} drove: {drives_in_words}")
    if robot.local_planner not in known_planners:
        planners_in_words = f"{known_planners[0]} drove, {robot.name} has {robot.local_planner}"
        remedy = "its base_local_planner is another"
        raise ApplrError(_other_robot(planners_in_words, options, remedy))


def _other_robot(differs: str, options: RecordedOptions, remedy: str) -> str:
    """Return what is said of a bag of another robot."""
    # Who gave the robot is not asked to give it.
    if "robot" in options.model_fields_set:
        return f"{differs}: {remedy}"
    return f"{differs}: give the robot as --robot"


def _check_columns(drive: Drive, robot: Robot, names: TopicNames, types: Mapping[str, str]) -> None:
    """Raise ApplrError if a column is missing that the replay needs."""
    channels = {"odometry": "odometry", "scans": "scans", "planned": "commands"}
    for column, channel in channels.items():
        if not getattr(drive, column):
            raise ApplrError(missing(channel, names, types))
    if not drive.plans and not drive.routes:
        raise ApplrError(missing_plans(robot.local_planner, names, types))


def _without_prefix(drive: Drive) -> Drive:
    """Return a drive without the prefix of its frames, such as robot1/ (tf_prefix)."""
    # Plans may be in a map frame that several robots share, which has no prefix.
    prefixes: Set[str] = set()
    for frame_name in (*drive.frames["odometry"], *drive.frames["scans"]):
        prefixes.add(frame_name.rpartition("/")[0])
    if len(prefixes) != 1 or "" in prefixes:
        return drive
    prefix = f"{prefixes.pop()}/"

    def shortened(names: List[str]) -> List[str]:
        return [frame_name.removeprefix(prefix) for frame_name in names]

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
    frame = drive.frame.removeprefix(prefix)
    return replace(drive, frame=frame, frames=frames_of, transforms=transforms)


# -- laser -----------------------------------------------------------------------------------------
def _place_laser(drive: Drive, tree: Tree, options: RecordedOptions) -> None:
    """Take the laser's place from tf, if tf has it, and turn scans of a laser upside down.

    Raises:
        ApplrError: The scans are those of a laser that neither robot.yaml nor tf knows.
    """
    robot = options.robot
    (frame,) = drive.frames["scans"]
    assert drive.scans is not None
    laser_place = tree.place(robot.frames.base, frame, drive.scans.stamp[:1])
    if laser_place is None:
        if frame != robot.laser.frame:
            differs = f"scans in {frame}, {robot.name} has {robot.laser.frame}"
            remedy = "give --scan, or record /tf and /tf_static"
            raise ApplrError(_other_robot(differs, options, remedy))
        return
    rotation = laser_place.rotation.as_matrix()[0]
    # The laser's x axis gives its heading, also upside down; its z axis shows how it is mounted.
    laser_yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    upright = float(rotation[2, 2])
    laser_x, laser_y = laser_place.position[0, :2].tolist()
    if upright < 0.0:
        drive.scans = _mirrored(drive.scans)
        drive.notes.append("the laser is mounted upside down (tf): its beams are taken in reverse")
    if abs(upright) < TILTED:
        degrees = np.degrees(np.arccos(min(abs(upright), 1.0)))
        drive.notes.append(f"tf tilts the laser by {degrees:.0f} degrees: it is taken as level")
    known_x, known_y, known_yaw = robot.laser.pose
    moved_distance = np.hypot(laser_x - known_x, laser_y - known_y)
    turned_angle = abs(normalize_angle_modulo(laser_yaw - known_yaw))
    if moved_distance > LASER_OFF_M or turned_angle > LASER_OFF_RAD:
        drive.laser_pose = (laser_x, laser_y, laser_yaw)
        drive.notes.append(
            f"tf has the laser at ({laser_x:.2f}, {laser_y:.2f}) m, {laser_yaw:.2f} rad, "
            f"robot.yaml at ({known_x:.2f}, {known_y:.2f}) m, {known_yaw:.2f} rad: "
            "tf's place is taken"
        )


def _mirrored(scans: Scans) -> Scans:
    """Return the scans of a laser upside down as those of an upright one.

    Its beams turn from left to right, so that the last one becomes the first.
    """
    mirrored_fans = scans.fan.copy()
    mirrored_ranges = []
    for row, ranges in enumerate(scans.ranges):
        first_angle, increment = mirrored_fans[row, :2]
        last_angle = first_angle + increment * (len(ranges) - 1)
        mirrored_fans[row, 0] = -last_angle
        mirrored_ranges.append(ranges[::-1].copy())
    return replace(scans, fan=mirrored_fans, ranges=mirrored_ranges)


# -- poses -----------------------------------------------------------------------------------------
def _take_poses(drive: Drive, tree: Tree, robot: Robot) -> None:
    """Take the poses from tf, if it has them, as Costmap2DROS::getRobotPose does."""
    assert drive.odometry is not None
    (topic_frame,) = drive.frames["odometry"]
    link = tree.busiest(drive.frame, robot.frames.base)
    if link is None:
        return
    later = stamped_later(drive.odometry, link)
    if abs(later) > APART_S:
        drive.odometry = replace(drive.odometry, stamp=drive.odometry.stamp - later)
        problem = clocks_differ("the odometry is", later, "tf")
        drive.notes.append(f"{problem}; {one_clock('base')}")
    # tf at the messages of the topic, to compare them, and at its own messages, to take them
    at_topic = tree.place(topic_frame, robot.frames.base, drive.odometry.stamp)
    at_link = tree.place(drive.frame, robot.frames.base, link.stamp)
    assert at_topic is not None
    assert at_link is not None
    by_topic = drive.odometry.pose
    by_tf = at_topic.planar
    largest_distance = float(distances(by_topic[:, :2], by_tf[:, :2]).max())
    turned_angles = normalize_angle_modulo(by_topic[:, 2] - by_tf[:, 2])
    largest_turn = float(np.abs(turned_angles).max())
    drive.odometry = _joined(drive.odometry, link.time, link.stamp, at_link.planar)
    if largest_distance > POSE_OFF_M or largest_turn > POSE_OFF_RAD:
        drive.notes.append(
            f"the odometry topic is not what tf shows: up to {largest_distance:.2f} m and "
            f"{largest_turn:.2f} rad apart; poses are tf's, velocities the topic's"
        )


def _joined(motion: Motion, times: np.ndarray, stamps: np.ndarray, poses: np.ndarray) -> Motion:
    """Return the velocities of a motion with other poses (n, 3), recorded at `times` for `stamps`.

    The planner takes the latest message of each. So a row is a message of the more frequent one,
    with the message of the other whose stamp is nearest; nothing is interpolated.
    """
    # Two of one rate may differ by some messages at the ends.
    if len(stamps) > 1.2 * len(motion):
        nearest_messages = nearest_rows(motion.stamp, stamps)
        return Motion(np.maximum.accumulate(times), stamps, poses, motion.twist[nearest_messages])
    nearest_messages = nearest_rows(stamps, motion.stamp)
    return replace(motion, stamp=stamps[nearest_messages], pose=poses[nearest_messages])


def _compare_clocks(drive: Drive) -> None:
    """Compare the stamps of scans with those of the poses that place them.

    Raises:
        ApplrError: tf's buffer holds no poses for the scans, so that costmap_2d drops them.
    """
    assert drive.scans is not None
    assert drive.odometry is not None
    apart = scans_apart(drive.scans, drive.odometry)
    if not apart:
        return
    if abs(stamped_later(drive.scans, drive.odometry)) > TF_BUFFER_S:
        raise ApplrError(f"{apart}, or tf drops the scans")
    drive.notes.append(apart)


def _compare_velocities(drive: Drive) -> None:
    """Compare velocities and poses of the odometry; of velocities left at 0, take the poses'."""
    motion = drive.odometry
    assert motion is not None
    check = OdometryCheck()
    for stamp, (x, y, yaw), (v, w) in _messages(motion):
        # What is said first stands for the whole drive.
        if check.take(stamp, (x, y, yaw), (v, w)):
            break
    if not check.problem:
        return
    drive.notes.append(check.problem)
    if check.lacks_twist:
        drive.planner_twist = motion.twist
        drive.odometry = replace(motion, twist=_velocities_by_poses(motion))


def _velocities_by_poses(motion: Motion) -> np.ndarray:
    """Return the velocities (n, 2) v [m/s], w [rad/s] that the poses of a motion show.

    They are the recorded ones if the poses are too rare to show any.
    """
    by_poses = PoseMotion(VELOCITY_SPAN_S)
    middle_stamps = []
    velocities = []
    for stamp, (x, y, yaw), (recorded_v, _) in _messages(motion):
        by_poses.take(stamp, (x, y, yaw), recorded_v)
        if not by_poses.baseline:  # Nothing is known at the begin and after a gap.
            continue
        # A velocity holds for the middle of the time over which it is measured.
        middle_stamps.append(stamp - by_poses.baseline / 2)
        velocities.append((by_poses.velocity.v, by_poses.velocity.w))
    if not velocities:
        return motion.twist
    measured_v, measured_w = np.array(velocities).T
    v = np.interp(motion.stamp, middle_stamps, measured_v)
    w = np.interp(motion.stamp, middle_stamps, measured_w)
    return np.column_stack([v, w])


def _messages(motion: Motion) -> Iterator[Tuple[float, List[float], List[float]]]:
    """Yield stamp, pose and twist of each message, as plain numbers."""
    return zip(motion.stamp.tolist(), motion.pose.tolist(), motion.twist.tolist())


# -- plans -----------------------------------------------------------------------------------------
def plans_of(drive: Drive, tree: Tree, robot: Robot) -> Plans:
    """Return the plans that were followed, or the parts of the global planner's that may have been.

    DWAPlannerROS publishes empty plans as long as it finds no command.

    Raises:
        ApplrError: As followed_plans.
    """
    plans = drive.plans
    if plans and (not drive.routes or any(map(len, plans.path))):
        return plans
    return followed_plans(drive, tree, robot)


def followed_plans(drive: Drive, tree: Tree, robot: Robot) -> Plans:
    """Return the plan that the local planner has in the cycle of each command.

    It is the global planner's latest, in the odometry frame, without the points that were pruned in
    earlier cycles. The planner cuts and prunes it again at the pose of its cycle. A plan that came
    during the cycle may be too late for it: the one before then stands in a row of the same time.

    Raises:
        ApplrError: The plans are in another frame, and tf does not connect it with the odometry's.
    """
    assert drive.routes is not None
    assert drive.planned is not None
    assert drive.odometry is not None
    (plan_frame,) = drive.frames["routes"]
    times = drive.planned.time
    origins: Optional[np.ndarray] = None
    if plan_frame != drive.frame:
        frame_places = tree.place(plan_frame, drive.frame, times)
        if frame_places is None:
            raise _unconnected(plan_frame, drive)
        origins = frame_places.planar
    move_base = MoveBase(counting_cells(robot.parameters()))
    half_window = half_size(move_base.local_costmap)
    prunes = bool(move_base.parameters[move_base.local_planner_name]["prune_plan"])

    followed_times: List[float] = []
    followed_paths: List[np.ndarray] = []
    route_row = -1
    # What is left of the latest plan, and what was left of the one before it
    stored_plan = np.zeros((0, 3))
    previous_plan = stored_plan
    for cycle_row, command_time in enumerate(times.tolist()):
        if drive.routes.latest(command_time) != route_row:
            route_row = drive.routes.latest(command_time)
            previous_plan = stored_plan
            stored_plan = drive.routes.path[route_row]
        odometry_row = drive.odometry.latest(command_time)
        if route_row < 0 or odometry_row < 0:
            continue
        if not len(stored_plan) or not _has_goal(drive, command_time):
            continue
        choices = [stored_plan]
        if len(previous_plan) and command_time - drive.routes.time[route_row] < CYCLE_S:
            choices.insert(0, previous_plan)
        # Frames move in each other, so that a stored plan is transformed anew in each cycle.
        if origins is not None:
            choices = [_seen_from(origins[cycle_row], choice) for choice in choices]
        followed_times += [command_time] * len(choices)
        followed_paths += choices
        x, y, _ = drive.odometry.pose[odometry_row].tolist()
        _, dropped_count = cut_plan(choices[-1], x, y, half_window, prunes)
        stored_plan = stored_plan[dropped_count:]
    return Plans(np.array(followed_times), followed_paths)


def _routes_by_odometry(drive: Drive, tree: Tree) -> Optional[Plans]:
    """Return the global planner's plans in the odometry frame, or None if tf lacks it."""
    if drive.routes is None or drive.frames["routes"] == [drive.frame]:
        return drive.routes
    plan_frame = drive.frames["routes"][0]
    frame_places = tree.place(plan_frame, drive.frame, drive.routes.time)
    if frame_places is None:
        return None
    routes = []
    for route, origin in zip(drive.routes.path, frame_places.planar):
        routes.append(_seen_from(origin, route))
    return Plans(drive.routes.time, routes)


def _unconnected(frame: str, drive: Drive) -> ApplrError:
    """Return the error of plans in a frame that tf does not connect with the odometry's."""
    return ApplrError(
        f"the plan is in {frame}, the odometry in {drive.frame}: record /tf and /tf_static"
    )


def _seen_from(origin: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return a path (n, 3) in the frame that lies at `origin` (3,) x, y [m], yaw [rad]."""
    x, y, yaw = origin.tolist()
    return transformed(path, inverse((x, y, yaw)))


def _has_goal(drive: Drive, time: float) -> bool:
    """Return whether a goal was pursued at a time, or whether nobody knows."""
    if not drive.goals:
        return True
    return any(goal.begin - STATUS_S <= time <= goal.end for goal in drive.goals)
