"""One bag of a drive: where the robot was at each scan, the courses that it drove, and what that says of the robot.

courses.py joins several of them.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.monitor.scanner import geometry_fault
from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot, geometry, measured
from applr_ros1.robots.measured import Fields, Value
from training.bags import SECOND
from training.bags.bag import Bag, BagError, Poses, Scans
from training.bags.response import second_on
from training.bags.topics import TopicNames
from worlds import Course, World
from worlds.seen import REACH, Scan, Seen, seen

BEGUN_M = 0.1  # a drive's time begins where the robot has come so far
LEAST_WAY_M = 1.0  # of a drive
MISSED_M = 1.5  # from its goal a drive has not reached it
JUMP_M, FASTEST_M_S = 0.3, 5.0  # poses farther apart than this much and that fast are a jump,
PAUSE_S = 5.0  # and so is a longer time between two, as where a clock is set
NOWHERE = 1e6  # [m, m/s] no pose is so far from its frame's origin, and nothing so fast
SCAN_INTERVAL_S, SCAN_COUNT = 0.2, 1000  # of the scans that a world is made of, and how many at most
PATH_STEP_M = 0.2  # between points of the reference path
MOUNT_TOLERANCE = 0.03  # [m + rad] as well as robot.yaml says where the scanner is
FARTHEST = "the course ends where it was farthest from its start"
SAMPLES, SAMPLED_S = 15, 3.0  # that a value needs
GONE_M2 = 0.05  # that must have gone before something counts as moving


class Pace(NamedTuple):
    """Figures of a drive: time [s], way [m], largest speed [m/s], time in which it stood [s], whether it arrived."""

    time_s: float
    path_m: float
    top: float
    standing_s: float
    arrived: float = True

    @classmethod
    def of(cls, time: np.ndarray, poses: np.ndarray, arrived: bool = True) -> Pace:
        """Measure times (n,) [s] and poses (n, >= 2) [m], from the first BEGUN_M on, in steps of SCAN_INTERVAL_S."""
        begin = time[np.argmax(np.hypot(*(poses[:, :2] - poses[0, :2]).T) >= BEGUN_M)]
        grid = np.append(np.arange(begin, time[-1] - 0.5 * SCAN_INTERVAL_S, SCAN_INTERVAL_S), time[-1])
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
    """A course to one goal of a bag, as it was driven.

    worlds: the course with the unseen as free, and as wall. poses (n, 3), theta (n, k): the space's parameters there;
    servers: all values of move_base's servers at its start. monitored: this package's monitor was behind the planner.
    """

    name: str
    worlds: Tuple[World, World]
    pace: Pace
    poses: np.ndarray
    theta: np.ndarray
    servers: Dict[str, Dict[str, Any]]
    monitored: bool


class Drive:
    """A bag, its scans placed in the map's frame, or else the odometry's, and there laid over each other.

    Args:
        bag: With the ranges of its scans, which are changed in place.
        robot: Who drove.
        wanted: Names of the topics as robot.yaml has them.

    Attributes:
        fields: What was measured of the robot, after measure().
        remarks: What is wrong or not there.
        lacks: Whether something that is worth recording was not.

    Raises:
        BagError: It cannot be used.
    """

    def __init__(self, bag: Bag, robot: Robot, wanted: TopicNames):
        self.bag, self.robot, self.name = bag, robot, re.sub(r"[^\w.+-]", "_", bag.path.stem)
        self.space = space_of(robot)
        self.parameters = bag.parameters(self.space)
        self.fields: Fields = {}
        self.remarks: List[str] = []
        self.lacks = False
        instead = [topic for topic, name in zip(bag.topics.main, wanted.main) if topic != name]
        if instead:
            self.remarks.append(f"not recorded under the names of robot.yaml, and read instead: {', '.join(instead)}")
        if bag.further:
            others = ", ".join(bag.further)
            self.remarks.append(f"of the lasers on {bag.topics.scan} that of {bag.scans.frame} is read, not {others}")
        if bag.cut_short:
            self.remarks.append("it is cut short: what is whole of it is read")
        self._find_the_odometry(wanted.odometry)
        servers = dict(self.space.places()) if not bag.decisions else ()
        silent = ", ".join(server or "move_base" for server in servers if server not in self.parameters)
        if silent:
            self._lacks(f"no parameter_updates of {silent}: values of the robot's files are taken")
        self._find_the_map()
        self._place_scans()
        self.way = float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())
        if np.hypot(*np.ptp(self.poses[:, :2], axis=0)) < LEAST_WAY_M:
            raise BagError("the robot stands: record a drive")

    def _lacks(self, remark: str) -> None:
        self.lacks = True
        self.remarks.append(remark)

    # -- where the robot was -----------------------------------------------------------------------
    def _find_the_odometry(self, wanted: str) -> None:
        """Set the odometry to its longest stretch in which nothing jumps, and the scans' stamps to the same clock."""
        bag, frames = self.bag, self.robot.frames
        self.scans, driven = bag.scans, bag.odometry
        if not len(driven.stamp) or not bag.topics.odometry.endswith(wanted) and _name(driven.frame) != frames.odom:
            driven = _poses_of_tf(bag.transforms, frames.odom, frames.base)
            self._lacks(f"nothing on {wanted}: poses are those of tf")
        for what, times in ((bag.topics.scan, self.scans.at), (f"{wanted} nor in {bag.topics.tf}", driven.stamp)):
            if not len(times):
                raise BagError(f"nothing on {what}: record it")
        if max(abs(np.median(one.at - one.stamp)) for one in (self.scans, driven)) > SECOND:
            self.remarks.append("recorded on another clock than its messages': the times of recording are taken")
            self.scans, driven = self.scans._replace(stamp=self.scans.at), driven._replace(stamp=driven.at)
        if not driven.twist.any():
            driven = driven._replace(twist=_twists(driven.stamp, driven.pose))
        good = np.flatnonzero((np.abs(np.column_stack([driven.pose, driven.twist])) < NOWHERE).all(axis=1))
        seconds, steps = np.diff(driven.stamp[good]) / SECOND, np.diff(driven.pose[good, :2], axis=0)
        apart = np.hypot(*steps.T) > JUMP_M + FASTEST_M_S * seconds
        jumps = np.flatnonzero(apart | (seconds < 0.0) | (seconds > PAUSE_S)) + 1
        if len(jumps):
            remark = f"the odometry or its clock jumps {len(jumps)} times"
            self.remarks.append(f"{remark}: the longest stretch without is taken")
        part = max(np.split(good, jumps), key=len)
        if len(part) < SAMPLES:
            raise BagError(f"{len(part)} possible poses in a row on {bag.topics.odometry}: record a drive")
        self.odometry = driven._replace(
            **{name: getattr(driven, name)[part] for name in ("at", "stamp", "pose", "twist")}
        )

    def _find_the_map(self) -> None:
        """Set the frame of the poses, and where the odometry's frame was in it: [(from [ns], pose), ...]."""
        self.frame, self.placed = self.odometry.frame, [(0, (0.0, 0.0, 0.0))]
        for (name, child), rows in self.bag.transforms.items():
            if child != self.frame or len(rows) < 2:
                continue
            jumps = sum(math.dist(a[:2], b[:2]) > JUMP_M for (_, a), (_, b) in zip(rows, rows[1:]))
            if not jumps:
                self.frame, self.placed = name, rows
                return
            remark = f"the localisation in {name} jumps {jumps} times"
            self.remarks.append(f"{remark}: scans are laid over each other instead")

    def _above(self, at: int) -> Pose:
        """Return the pose of the odometry's frame in self.frame at a time [ns]."""
        return _last(self.placed, at)

    def _laser(self, frame: str) -> Tuple[Pose, bool]:
        """Return the scanner's pose on the base and whether it hangs upside down: of tf, or else of robot.yaml."""
        above = {child: (parent, rows[0][1]) for (parent, child), rows in self.bag.transforms.items()}
        pose, inverted, link, given = (0.0, 0.0, 0.0), False, frame, self.robot.laser.pose
        while _name(link) != self.robot.frames.base:
            if link not in above:
                return given, False
            parent, placed = above.pop(link)  # a frame may hang from itself
            if (parent, link) in self.bag.inverted:
                pose, inverted = (pose[0], -pose[1], -pose[2]), not inverted
            pose, link = compose(placed, pose), parent
        x, y, yaw = pose
        if not inverted and math.dist((x, y), given[:2]) + abs(normalize_angle(yaw - given[2])) <= MOUNT_TOLERANCE:
            return given, False
        turned = f"{yaw:.2f} rad" + ", upside down" * inverted
        self.remarks.append(f"tf has {frame} at {x:.2f}, {y:.2f} m, {turned}: taken instead of laser.pose")
        return pose, inverted

    def _place_scans(self) -> None:
        """Set times (n,) [ns] and poses (n, 3) of the robot at its scans, and the scans as seen from there."""
        scans, odometry = self.scans, self.odometry
        inside = (scans.stamp >= odometry.stamp[0]) & (scans.stamp <= odometry.stamp[-1])
        used = [i for i in np.flatnonzero(inside).tolist() if _is_a_scan(scans, i)]
        if len(used) < SAMPLES:
            raise BagError(f"{len(used)} scans while there is odometry: record a drive, on one clock")
        track = [*odometry.pose[:, :2].T, np.unwrap(odometry.pose[:, 2])]
        by_odometry = np.column_stack([np.interp(scans.stamp[used], odometry.stamp, values) for values in track])
        self.code = _no_return(scans, used[:: math.ceil(len(used) / 50)])
        laser, inverted = self._laser(scans.frame)
        matcher, lost, poses = ScanMatcher(), 0, []
        self.seen: List[Scan] = []
        for i, driven in zip(used, by_odometry):
            stamp, ranges, (first, step, low, high) = scans.stamp[i], scans.of(i), scans.geometry[i].tolist()
            pose = compose(self._above(stamp), _pose(driven))
            ranges[(ranges == np.float32(self.code)) | (ranges >= high)] = np.inf
            ranges[ranges < low] = np.nan
            if inverted:
                first, ranges[:] = -first - (len(ranges) - 1) * step, ranges[::-1].copy()
            matcher.see(LaserScan(stamp / SECOND, first, step, low, high, ranges, compose(pose, laser)))
            lost += matcher.lost
            poses.append(matcher.corrected(pose))
            self.seen.append(Scan(compose(poses[-1], laser), first, step, ranges))
        self.times, self.poses = scans.stamp[used], np.array(poses)
        if lost:
            self.remarks.append(f"scans contradict the poses {lost} times: the world may be wrong there")

    # -- the courses -------------------------------------------------------------------------------
    def courses(self) -> List[DrivenCourse]:
        """Return the course of each goal. Raises BagError where the robot has driven to none."""
        step = SCAN_INTERVAL_S * SECOND / max(float(np.median(np.diff(self.times))), 1.0)
        back, front, right, left = geometry.bounding_box(self.robot)
        inner, outer = min(front, -back, left, -right), math.hypot(max(front, -back), max(left, -right))
        every = max(1, int(step), math.ceil(len(self.times) / SCAN_COUNT))
        place = seen(self.seen[::every], self.poses[:, :2], inner, outer)
        if not len(place.surfaces):
            self.remarks.append(f"no scan shows anything within {REACH:g} m: the course is open floor")
        if place.gone > GONE_M2:
            self.remarks.append(f"something moved: {place.gone:.1f} m^2 that were free later are left out")
        goals = self._goals()
        found = [self._course(n + 1, *goal, place) for n, goal in enumerate(goals)]
        courses = [course for course in found if course is not None]
        if len(courses) < len(goals):
            self.remarks.append(f"{len(goals) - len(courses)} of {len(goals)} goals were hardly driven to: left out")
        if not courses:
            raise BagError(f"no goal was driven to ({'; '.join(self.remarks)})")
        return courses

    def _goals(self) -> List[Tuple[int, int, Optional[Pose]]]:
        """Return (from [ns], until [ns], pose in self.frame or None where it is not known) of each goal."""
        bag, found = self.bag, []
        news = [goal for goal, last in zip(bag.goals, [(), *bag.goals]) if goal[1:] != last[1:]]  # some send it often
        if not news:
            self._lacks(f"no goal: {FARTHEST}")
            return [(int(self.times[0]), int(self.times[-1]), None)]
        ends = [*(goal[0] for goal in news), *(at for at, _ in bag.results.values()), bag.end]
        for at, frame, *pose in news:
            change = self._in_frame(frame, at)
            goal = compose(change, _pose(pose)) if change is not None and np.isfinite(pose).all() else None
            if goal is None:
                self.remarks.append(f"nothing says where a goal in the frame {frame[:60]!r} is: {FARTHEST}")
            found.append((at, min((end for end in ends if end > at), default=at), goal))
        return found

    def _in_frame(self, frame: str, at: int) -> Optional[Pose]:
        """Return the pose of a frame in self.frame at a time [ns]; None where no tf says it."""
        if frame in ("", self.frame):
            return (0.0, 0.0, 0.0)
        if frame == self.odometry.frame:
            return self._above(at)
        rows = [pose for time, pose in self.bag.transforms.get((frame, self.odometry.frame), ()) if time <= at]
        return inverse(rows[-1]) if rows else None

    def _course(self, number: int, begin: int, end: int, goal: Optional[Pose], place: Seen) -> Optional[DrivenCourse]:
        during = (self.times >= begin) & (self.times <= end)
        poses, times = self.poses[during], self.times[during]
        if len(poses) < 3 or np.hypot(*np.ptp(poses[:, :2], axis=0)) < LEAST_WAY_M:
            return None
        short = np.hypot(*(poses[:, :2] - goal[:2]).T).min() if goal else 0.0
        if short > MISSED_M:
            self.remarks.append(f"goal {number} was not reached ({short:.1f} m): {FARTHEST}")
        if not goal or short > MISSED_M:
            goal = _pose(poses[np.argmax(np.hypot(*(poses[:, :2] - poses[0, :2]).T))])
        left = np.hypot(*(poses[:, :2] - goal[:2]).T)
        tolerance = max(self.robot.goal_tolerance, float(left.min()) + 0.02)
        last = int(np.argmax(left <= tolerance)) + 1
        poses, times = poses[:last], times[:last]
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        path = poses[np.unique(gone // PATH_STEP_M, return_index=True)[1], :2]
        course = Course(_pose(poses[0]), _pose(goal), None, tolerance, path, planner_ends=True)
        free, dark = (_near(circles, path) for circles in (place.surfaces, place.unseen))
        name = f"{self.name}_{number}" if len(self.bag.goals) > 1 else self.name
        worlds = (
            World(name, free, np.empty((0, 5)), course),
            World(f"{name}-wall", np.vstack([free, dark]), np.empty((0, 5)), course),
        )
        theta = np.array([self._theta(at) for at in times.tolist()])
        servers = {server: _last(rows, begin) for server, rows in self.parameters.items()}
        pace = Pace.of(times / SECOND, poses)
        return DrivenCourse(name, worlds, pace, poses, theta, servers, bool(self.bag.decisions))

    def _theta(self, at: int) -> np.ndarray:
        """Return the parameters (k,) in force at a time [ns]; what the bag does not say is as in the robot's files."""
        theta = self.space.theta0.copy()
        made = [decision for decision in self.bag.decisions if decision.at <= at]
        decided = (made[-1].after or made[-1].before) if made else {}
        for i, name in enumerate(self.space.names):
            target = self.space.targets[name][0]
            values = _last(self.parameters.get(target.server, [(0, {})]), at)
            theta[i] = decided.get(name, next((values[known] for known in target.names if known in values), theta[i]))
        return theta

    # -- the robot ---------------------------------------------------------------------------------
    def measure(self) -> None:
        """Fill `fields` with what the drive says of those of robot.yaml."""
        self._measure_base()
        if not math.isnan(self.code) and self.code != self.robot.laser.no_return:
            self.fields["laser", "no_return"] = Value(self.code, "m", 0.0, "most of the ranges that are none")
        self._measure_noise()
        self._measure_drift()

    def _measure_base(self) -> None:
        odometry, (at, commands) = self.odometry, self.bag.commands
        used = (at >= odometry.stamp[0]) & (at <= odometry.stamp[-1]) & (np.abs(commands) < NOWHERE).all(axis=1)
        at, commands = at[used], commands[used]
        if len(at) < SAMPLES or np.ptp(at) < SAMPLED_S * SECOND or np.ptp(commands[:, 0]) < measured.LEAST:
            self._lacks(f"hardly a command on {self.bag.topics.command}: nothing of the base is measured")
            return
        given = at / SECOND, commands, odometry.stamp / SECOND, odometry.twist
        self.fields.update(measured.base(*given, SAMPLES))
        top = np.percentile(np.abs(odometry.twist), 99.5, axis=0)
        braked = "" if ("monitor", "deceleration") in self.fields else ", and never braked hard (measure_braking.py)"
        self.remarks.append(f"it drove up to {top[0]:.2f} m/s and {top[1]:.2f} rad/s{braked}")
        metres, turned = second_on(self.robot, at, commands, odometry)
        off = f"{metres:.3f} m and {turned:.3f} rad off a second on"
        self.remarks.append(f"the same commands leave the simulated base {off}")

    def _measure_noise(self) -> None:
        stamps, twist = self.odometry.stamp, self.odometry.twist
        slow = [np.abs(np.interp(self.times, stamps, twist[:, k])) < measured.STILL[k] for k in (0, 1)]
        still = np.flatnonzero((slow[0] & slow[1])[1:]) + 1
        pairs = [(self.seen[i - 1].ranges, self.seen[i].ranges) for i in still]
        with np.errstate(invalid="ignore"):  # inf - inf
            off = [np.abs(b - a) for a, b in pairs if len(a) == len(b)]
        noise = [1.4826 * np.median(row[row < 0.1]) / math.sqrt(2.0) for row in off if (row < 0.1).any()]
        if len(noise) < SAMPLES:
            self.remarks.append("it hardly stands: the scanner's noise is not measured")
        else:
            self.fields["laser", "noise"] = measured.middle(noise, "m", "scans standing")

    def _measure_drift(self) -> None:
        odometry = self.odometry
        if self.frame == odometry.frame:
            self.remarks.append("no map in tf: the odometry's drift is not measured")
            return
        begin, end = (_pose(odometry.pose[i]) for i in (0, -1))
        by_odometry = compose(inverse(begin), end)
        begin, end = compose(self._above(odometry.stamp[0]), begin), compose(self._above(odometry.stamp[-1]), end)
        by_map = compose(inverse(begin), end)
        longer = abs(math.hypot(*by_odometry[:2]) - math.hypot(*by_map[:2])) / self.way
        turned = abs(normalize_angle(by_odometry[2] - by_map[2]))
        for name, value, unit in (("scale_error", longer, ""), ("heading_drift", turned, "rad")):
            spread = max(value, 0.5 * getattr(self.robot.odometry, name))  # a standard deviation allows small draws
            self.fields["odometry", name] = Value(value, unit, spread, f"against the map after {self.way:.0f} m")


def _pose(values) -> Pose:
    x, y, yaw = map(float, values)
    return x, y, yaw


def _last(rows, at):
    """Return what was recorded last until a time, or else first."""
    return rows[max(0, bisect_right(rows, at, key=lambda row: row[0]) - 1)][1]


def _near(circles, path):
    """Return those of circles (n, 3) that lie within REACH of points (k, 2)."""
    away = np.hypot(circles[:, :1] - path[:, 0], circles[:, 1:2] - path[:, 1])
    return circles[away.min(axis=1) < REACH] if len(circles) else circles


def _no_return(scans: Scans, some: Sequence[int]) -> float:
    """Return the range that scans state where nothing returns; NaN where that is +inf, or everything returns."""
    ranges = np.concatenate([scans.of(i).astype(np.float64) for i in some])
    odd = ranges[np.isfinite(ranges) & ((ranges == 0.0) | (ranges >= scans.geometry[some[0], 3]))]
    codes, counts = np.unique(odd, return_counts=True)
    return float(codes[np.argmax(counts)]) if len(odd) > 0.01 * len(ranges) else math.nan


def _is_a_scan(scans: Scans, i: int) -> bool:
    first, step, low, high = scans.geometry[i].tolist()
    return not geometry_fault(LaserScan(0.0, first, step, low, high, scans.of(i), (0.0, 0.0, 0.0)))


def _name(frame: str) -> str:
    """Return a frame without the name of its robot."""
    return frame.rpartition("/")[2]


def _poses_of_tf(transforms, odom: str, base: str) -> Poses:
    """Return the odometry as tf has it, without twists; empty where it has none."""
    here = (frames for frames in transforms if tuple(map(_name, frames)) == (odom, base))
    frames = next(here, (odom, base))
    rows = transforms.get(frames, [])
    at, first = np.unique(np.array([at for at, _ in rows], dtype=np.int64), return_index=True)
    pose = np.array([pose for _, pose in rows], dtype=np.float64).reshape(-1, 3)[first]
    return Poses(at, at, pose, np.zeros((len(at), 2)), frames[0])


def _twists(stamp, pose) -> np.ndarray:
    """Return (n, 2) speed ahead [m/s] and yaw rate [rad/s] of poses (n, 3), whose odometry states none."""
    if len(pose) < 3 or (np.diff(stamp) <= 0).any():
        return np.zeros((len(pose), 2))
    x, y, yaw = (np.gradient(values, stamp / SECOND) for values in (*pose[:, :2].T, np.unwrap(pose[:, 2])))
    return np.column_stack([np.cos(pose[:, 2]) * x + np.sin(pose[:, 2]) * y, yaw])
