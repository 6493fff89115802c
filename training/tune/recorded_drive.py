"""One bag of a drive: where the robot was at each scan, the courses that it drove, and what that says of the robot.

bag.py joins several of them.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle
from applr_ros1.common.trees import branch
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.planner.parameters.check import complete
from applr_ros1.robots import Robot, geometry, measured
from applr_ros1.robots.measured import Fields, Value
from training.bags.reader import SECOND, BagError, Poses, TopicNames, read_messages
from worlds import Course, World
from worlds.seen import REACH, Scan, Seen, seen

FIRST = 0.1  # [m]: a drive's time begins where the robot has come so far
LEAST_WAY = 0.5  # [m] of a drive
FAR = 1.5  # [m] from its goal a drive has not reached it
JUMP, FASTEST = 0.3, 5.0  # [m, m/s]: poses farther apart than this much and that fast are a jump
OFTEN, MOST = 0.2, 1000  # s between two scans that a world is made of, and how many at most
SPACING = 0.2  # [m] of the reference path's points
SOME, SHORT, PERSON = 15, 3.0, 0.05  # samples and s that a value needs; m^2 that must have gone before it is told


class Drive(NamedTuple):
    """How a drive went: time [s], way [m], largest speed [m/s], time in which it stood [s], whether it arrived."""

    time_s: float
    path_m: float
    top: float
    standing_s: float
    arrived: float = True

    @classmethod
    def of(cls, time: np.ndarray, poses: np.ndarray, arrived: bool = True) -> Drive:
        """From times (n,) [s] and poses (n, >= 2) [m], from the first FIRST metres on, in steps of OFTEN seconds."""
        begin = time[np.argmax(np.hypot(*(poses[:, :2] - poses[0, :2]).T) >= FIRST)]
        grid = np.append(np.arange(begin, time[-1] - 0.5 * OFTEN, OFTEN), time[-1])
        x, y = (np.interp(grid, time, poses[:, k]) for k in (0, 1))
        steps, seconds = np.hypot(np.diff(x), np.diff(y)), np.maximum(np.diff(grid), 1e-3)
        standing = seconds[steps < 0.05 * seconds].sum()
        return cls(float(time[-1] - begin), steps.sum(), np.max(steps / seconds, initial=0.0), standing, arrived)

    def __str__(self) -> str:
        how = "" if self.arrived else ", not arrived"
        return (
            f"{self.time_s:.1f} s, {self.path_m:.1f} m, up to {self.top:.2f} m/s, {self.standing_s:.1f} s standing{how}"
        )


class DrivenCourse(NamedTuple):
    """A goal of a bag, as it was driven.

    worlds: the course with the unseen as free, and as wall. poses (n, 3), theta (n, k): the space's parameters there;
    servers: all values of move_base's servers at its start. monitored: this package's monitor was behind the planner.
    """

    name: str
    worlds: Tuple[World, World]
    drive: Drive
    poses: np.ndarray
    theta: np.ndarray
    servers: Dict[str, Dict[str, Any]]
    monitored: bool


class RecordedDrive:
    """A bag, its scans placed in the map's frame, or else the odometry's, and there laid over each other.

    Attributes:
        fields: What was measured, after measure().
        remarks: What is wrong or not there.
        lacks: Whether something that is worth recording was not.

    Raises:
        BagError: It cannot be used.
    """

    def __init__(self, path: Path, robot: Robot, topics: TopicNames):
        self.path, self.robot, self.topics = path, robot, topics
        self.fields: Fields = {}
        self.remarks: List[str] = []
        self.lacks = False
        self.bag = read_messages(path, topics, robot)
        if not len(self.bag.odometry.stamp):
            self.bag.odometry = _poses_of_tf(self.bag.transforms, robot)
            self._lacks(f"nothing on {topics.odometry}: poses are those of tf")
        for what, there in ((topics.scan, self.bag.scan_at), (f"{topics.odometry} nor /tf", self.bag.odometry.stamp)):
            if not len(there):
                raise BagError(f"{path}: nothing on {what}: record it")
        if not self.bag.odometry.twist.any():
            self.bag.odometry.twist = _twists(self.bag.odometry.stamp, self.bag.odometry.pose)
        if self.bag.silent:
            self._lacks(self.bag.silent)
        self._take_the_longest_stretch()
        self._find_the_map()
        self._place_scans()
        self.way = float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())
        if np.hypot(*np.ptp(self.poses[:, :2], axis=0)) < LEAST_WAY:
            raise BagError(f"{path}: the robot stands: record a drive")

    def _lacks(self, remark: str) -> None:
        self.lacks = True
        self.remarks.append(remark)

    # -- where the robot was -----------------------------------------------------------------------
    def _take_the_longest_stretch(self) -> None:
        """Leaves out what lies before and behind jumps of the odometry."""
        odometry = self.bag.odometry
        far = np.hypot(*np.diff(odometry.pose[:, :2], axis=0).T) > JUMP + FASTEST * np.diff(odometry.stamp) / SECOND
        cuts = [0, *(np.flatnonzero(far | (np.diff(odometry.stamp) < 0)) + 1), len(odometry.stamp)]
        longest = int(np.argmax(np.diff(cuts)))
        if len(cuts) > 2:
            self.remarks.append(f"the odometry jumps {len(cuts) - 2} times: the longest stretch without is taken")
        part = slice(cuts[longest], cuts[longest + 1])
        at, stamp, pose, twist = (row[part] for row in (odometry.at, odometry.stamp, odometry.pose, odometry.twist))
        self.bag.odometry = Poses(at, stamp, pose, twist, odometry.frame)

    def _find_the_map(self) -> None:
        """Sets the frame of the poses, and where the odometry's frame was in it: [(from [ns], pose), ...]."""
        self.frame, self.placed = self.bag.odometry.frame, [(0, (0.0, 0.0, 0.0))]
        for (name, child), rows in self.bag.transforms.items():
            if child != self.frame or len(rows) < 2:
                continue
            jumps = sum(math.dist(a[:2], b[:2]) > JUMP for (_, a), (_, b) in zip(rows, rows[1:]))
            if not jumps:
                self.frame, self.placed = name, rows
                return
            self.remarks.append(
                f"the localisation in {name} jumps {jumps} times: scans are laid over each other instead"
            )

    def _above(self, at: int) -> Pose:
        """The pose of the odometry's frame in self.frame at a time [ns]."""
        return _last(self.placed, at)

    def _place_scans(self) -> None:
        """Sets times (n,) [ns] and poses (n, 3) of the robot at its scans, and the scans."""
        bag, odometry, laser = self.bag, self.bag.odometry, self.robot.laser
        inside = (bag.scan_stamp >= odometry.stamp[0]) & (bag.scan_stamp <= odometry.stamp[-1])
        wanted = np.flatnonzero(inside).tolist()
        messages, poses, lost = bag.scans(wanted), [], 0
        if len(wanted) < SOME:
            raise BagError(f"{self.path}: {len(wanted)} scans within the odometry's time: record both on one clock")
        track = [*odometry.pose[:, :2].T, np.unwrap(odometry.pose[:, 2])]
        self.code = _no_return([messages[i] for i in wanted[:: math.ceil(len(wanted) / 50)]])
        matcher, self.scans = ScanMatcher(), []  # type: ScanMatcher, List[Scan]
        for i in wanted:
            message, stamp = messages[i], bag.scan_stamp[i]
            pose = compose(self._above(stamp), tuple(np.interp(stamp, odometry.stamp, values) for values in track))
            ranges = np.array(message.ranges, dtype=np.float32)
            ranges[(ranges == np.float32(self.code)) | (ranges >= message.range_max)] = np.inf
            ranges[ranges < message.range_min] = np.nan
            fan, limits = (message.angle_min, message.angle_increment), (message.range_min, message.range_max)
            matcher.see(LaserScan(stamp / SECOND, *fan, *limits, ranges, compose(pose, laser.pose)))
            lost += matcher.lost
            poses.append(matcher.corrected(pose))
            self.scans.append(Scan(compose(poses[-1], laser.pose), *fan, ranges))
        self.times, self.poses = bag.scan_stamp[wanted], np.array(poses)
        if lost:
            self.remarks.append(f"scans contradict the poses {lost} times: the world may be wrong there")

    # -- the courses -------------------------------------------------------------------------------
    def courses(self) -> List[DrivenCourse]:
        """That of each goal. BagError where the robot has driven to none."""
        often = OFTEN * SECOND / max(float(np.median(np.diff(self.times))), 1.0)
        back, front, right, left = geometry.bounding_box(self.robot)
        inner, outer = min(front, -back, left, -right), math.hypot(max(front, -back), max(left, -right))
        every = max(1, int(often), math.ceil(len(self.times) / MOST))
        place = seen(self.scans[::every], self.poses[:, :2], inner, outer)
        if place.gone > PERSON:
            self.remarks.append(f"something moved: {place.gone:.1f} m^2 that were free later are left out")
        found = [self._course(n + 1, *goal, place) for n, goal in enumerate(self._goals())]
        courses = [course for course in found if course is not None]
        if not courses:
            raise BagError(f"{self.path}: no goal was driven to ({'; '.join(self.remarks)})")
        return courses

    def _goals(self) -> List[Tuple[int, int, Pose]]:
        """(from [ns], until [ns], pose in self.frame) of each goal."""
        bag, found = self.bag, []
        if not bag.goals:
            self._lacks("no goal: it is where the drive ends")
            return [(int(self.times[0]), int(self.times[-1]), tuple(self.poses[-1]))]
        ends = [*(goal[0] for goal in bag.goals), *(at for at, _ in bag.results.values()), bag.end]
        for at, frame, *pose in bag.goals:
            change = self._in_frame(frame, at)
            if change is None:
                self.remarks.append(f"a goal in the frame {frame}, of which tf says nothing, is left out")
            else:
                found.append((at, min((end for end in ends if end > at), default=at), compose(change, tuple(pose))))
        return found

    def _in_frame(self, frame: str, at: int) -> Optional[Pose]:
        """The pose of a frame in self.frame at a time [ns]; None where no tf says it."""
        if frame in ("", self.frame):
            return (0.0, 0.0, 0.0)
        if frame == self.bag.odometry.frame:
            return self._above(at)
        rows = [pose for time, pose in self.bag.transforms.get((frame, self.bag.odometry.frame), ()) if time <= at]
        return inverse(rows[-1]) if rows else None

    def _course(self, number: int, begin: int, end: int, goal: Pose, place: Seen) -> Optional[DrivenCourse]:
        during = (self.times >= begin) & (self.times <= end)
        poses, times, bag = self.poses[during], self.times[during], self.bag
        if len(poses) < 3 or np.hypot(*np.ptp(poses[:, :2], axis=0)) < LEAST_WAY:
            self.remarks.append(f"goal {number} was hardly driven to and is left out")
            return None
        left = np.hypot(*(poses[:, :2] - goal[:2]).T)
        if left.min() > FAR:
            self.remarks.append(f"goal {number} was not reached: the course ends {left.min():.1f} m before it")
        values = branch(complete(self.robot.parameters()), self.robot.local_planner)
        tolerance = max(float(values.get("xy_goal_tolerance", 0.1)), float(left.min()) + 0.02)
        last = int(np.argmax(left <= tolerance)) + 1
        poses, times = poses[:last], times[:last]
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        path = poses[np.unique(gone // SPACING, return_index=True)[1], :2]
        course = Course(_pose(poses[0]), _pose(goal), None, tolerance, path)
        free, dark = (_near(circles, path) for circles in (place.surfaces, place.unseen))
        name = f"{self.path.stem}_{number}" if len(bag.goals) > 1 else self.path.stem
        worlds = (
            World(name, free, np.empty((0, 5)), course),
            World(f"{name}-wall", np.vstack([free, dark]), np.empty((0, 5)), course),
        )
        theta = np.array([self._theta(at) for at in times.tolist()])
        servers = {server: _last(rows, begin) for server, rows in bag.parameters.items()}
        drive = Drive.of(times / SECOND, poses)
        return DrivenCourse(name, worlds, drive, poses, theta, servers, bool(bag.decisions))

    def _theta(self, at: int) -> np.ndarray:
        """The parameters (k,) in force at a time [ns]; what the bag does not say is as in the robot's files."""
        bag, theta = self.bag, self.bag.space.theta0.copy()
        decided: dict = next((made for made in reversed(bag.decisions) if made["at"] <= at), {})
        said = decided.get("after") or decided.get("before") or {}
        for i, name in enumerate(bag.space.names):
            target = bag.space.targets[name][0]
            values = _last(bag.parameters.get(target.server, [(0, {})]), at)
            theta[i] = said.get(name, next((values[known] for known in target.names if known in values), theta[i]))
        return theta

    # -- the robot ---------------------------------------------------------------------------------
    def measure(self) -> None:
        """Fills `fields` with what the drive says of those of robot.yaml."""
        told, odometry = np.array(self.bag.commands, dtype=np.float64).reshape(-1, 3), self.bag.odometry
        told = told[(told[:, 0] >= odometry.stamp[0]) & (told[:, 0] <= odometry.stamp[-1])]
        if len(told) < SOME or np.ptp(told[:, 0]) < SHORT * SECOND or np.ptp(told[:, 1]) < measured.LEAST:
            self._lacks(f"hardly a command on {self.topics.command}: nothing of the base is measured")
        else:
            self._measure_base(told[:, 0] / SECOND, told[:, 1:], odometry.stamp / SECOND, odometry.twist)
        if not math.isnan(self.code) and self.code != self.robot.laser.no_return:
            self.fields["laser", "no_return"] = Value(self.code, "m", 0.0, "most of the ranges that are none")
        slow = [np.abs(np.interp(self.times, odometry.stamp, odometry.twist[:, k])) < measured.STILL[k] for k in (0, 1)]
        still = np.flatnonzero((slow[0] & slow[1])[1:]) + 1
        pairs = [(self.scans[i - 1].ranges, self.scans[i].ranges) for i in still]
        with np.errstate(invalid="ignore"):  # inf - inf
            off = [np.abs(b - a) for a, b in pairs if len(a) == len(b)]
        noise = [1.4826 * np.median(row[row < 0.1]) / math.sqrt(2.0) for row in off if (row < 0.1).any()]
        if len(noise) < SOME:
            self.remarks.append("it hardly stands: the scanner's noise is not measured")
        else:
            self._found("laser", "noise", noise, "m", "scans standing")
        if self.frame == odometry.frame:
            self.remarks.append("no map in tf: the odometry's drift is not measured")
            return
        begin, end = (tuple(odometry.pose[i]) for i in (0, -1))
        by_odometry = compose(inverse(begin), end)
        begin, end = (compose(self._above(odometry.stamp[i]), pose) for i, pose in ((0, begin), (-1, end)))
        by_map = compose(inverse(begin), end)
        longer = abs(math.hypot(*by_odometry[:2]) - math.hypot(*by_map[:2])) / self.way
        turned = abs(normalize_angle(by_odometry[2] - by_map[2]))
        for name, value, unit in (("scale_error", longer, ""), ("heading_drift", turned, "rad")):
            self.fields["odometry", name] = Value(value, unit, value, f"against the map after {self.way:.0f} m")

    def _measure_base(self, time, command, at, twist) -> None:
        how = measured.response(time, command[:, 0], at, twist[:, 0])
        parts = [part for part in np.array_split(np.arange(len(time)), 3) if np.ptp(command[part, 0]) >= measured.LEAST]
        each = [measured.response(time[p], command[p, 0], at, twist[:, 0]) for p in parts if np.ptp(time[p]) > SHORT]
        places = (
            ("simulation", "command_delay"),
            ("odometry", "lag"),
            ("base", "max_acceleration"),
            ("monitor", "deceleration"),
        )
        for n, place in enumerate(places):
            if math.isfinite(how[n + 1]):
                spread = float(np.std([one[n + 1] for one in each if math.isfinite(one[n + 1])] or [0.0]))
                self.fields[place] = Value(how[n + 1], "s" if n < 2 else "m/s^2", spread, f"{len(time)} commands")
        if math.isinf(how.slower):
            self.remarks.append("it never braked as hard as it can: measure_braking.py measures that")
        for column, name, unit in ((0, "max_speed", "m/s"), (1, "max_yaw_rate", "rad/s")):
            follows = measured.followed(time, command[:, column], at, twist[:, column], how.delay + how.lag)
            fast = np.abs(follows[:, 0]) > 0.9 * np.max(np.abs(follows[:, 0]), initial=0.0)
            if column and len(follows) >= SOME:
                self._found("monitor", "turn_gain", np.clip(follows[:, 1], 0.5, 3.0), "", "moments of steady turns")
            elif fast.sum() >= SOME and np.median(follows[fast, 1]) < measured.FELL:
                self._found("base", name, np.abs(follows[fast].prod(axis=1)), unit, "moments in which it was told more")
        top = np.percentile(np.abs(twist), 99.5, axis=0)
        self.remarks.append(f"it drove up to {top[0]:.2f} m/s and {top[1]:.2f} rad/s")

    def _found(self, section, name, values, unit, what) -> None:
        quartiles = np.percentile(values, (25, 50, 75))
        spread = float(quartiles[2] - quartiles[0]) / 1.35
        self.fields[section, name] = Value(float(quartiles[1]), unit, spread, f"{len(values)} {what}")


def _pose(values) -> Pose:
    x, y, yaw = map(float, values)
    return x, y, yaw


def _last(rows, at):
    """What was said last until a time, or else first."""
    return rows[max(0, bisect_right(rows, at, key=lambda row: row[0]) - 1)][1]


def _near(circles, path):
    """Those of circles (n, 3) that lie within REACH of points (k, 2)."""
    away = np.hypot(circles[:, :1] - path[:, 0], circles[:, 1:2] - path[:, 1])
    return circles[away.min(axis=1) < REACH] if len(circles) else circles


def _no_return(messages) -> float:
    """What scans state where nothing returns; NaN where that is +inf, or everything returns."""
    ranges = np.concatenate([np.asarray(message.ranges, dtype=np.float64) for message in messages])
    odd = ranges[np.isfinite(ranges) & ((ranges == 0.0) | (ranges >= messages[0].range_max))]
    codes, counts = np.unique(odd, return_counts=True)
    return float(codes[np.argmax(counts)]) if len(odd) > 0.01 * len(ranges) else math.nan


def _poses_of_tf(transforms, robot: Robot) -> Poses:
    """The odometry as tf has it, without twists; empty where it has none."""
    rows = transforms.get((robot.frames.odom, robot.frames.base), [])
    at = np.array([at for at, _ in rows], dtype=np.int64)
    pose = np.array([pose for _, pose in rows], dtype=np.float64).reshape(-1, 3)
    return Poses(at, at, pose, np.zeros((len(rows), 2)), robot.frames.odom)


def _twists(stamp, pose) -> np.ndarray:
    """(n, 2) speed ahead [m/s] and yaw rate [rad/s] of poses (n, 3), whose odometry states none."""
    if len(pose) < 3 or (np.diff(stamp) <= 0).any():
        return np.zeros((len(pose), 2))
    x, y, yaw = (np.gradient(values, stamp / SECOND) for values in (*pose[:, :2].T, np.unwrap(pose[:, 2])))
    return np.column_stack([np.cos(pose[:, 2]) * x + np.sin(pose[:, 2]) * y, yaw])
