"""What bags of drives with move_base say: their courses as worlds, with moved copies, and fields of the robot.

`./applr tune` searches on these worlds, with this robot. Before that Recorded.check drives the recorded parameters
through the recorded courses in the simulator, which shows how far the rest may be believed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Dict, List, NamedTuple, Sequence

import numpy as np

import sim_bridge
from applr_ros1.common.angles import normalize_angle, transform_point
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots import Robot, measured
from applr_ros1.robots.check import contradictions
from applr_ros1.robots.measured import Fields
from training.bags.bag import BagError, bags_in, refused
from training.bags.topics import TopicNames
from training.env.episode import TIME_LIMIT, Episode, counting_cells
from training.tune.recorded_drive import Drive, DrivenCourse, RecordedDrive
from worlds import World

MOVED = 0.1  # [m] by which obstacles, start and goal of copies are moved
WAVES = (3.0, 6.0)  # [m]: wavelengths of that, so that walls stay whole and passages passable
START = 0.02, 0.02  # [m, rad]: as well as scans tell where a drive began
BELIEVED = 0.2  # share of the recorded time by which the simulated one may differ
MANY = 9  # drives of a course after which simulated and recorded times agree or not
PERIOD = 1.0  # s between two looks at the recorded parameters


class Check(NamedTuple):
    """The recorded parameters in the simulator: a line a course, whether all agree, how far to believe the rest."""

    lines: List[str]
    agrees: bool
    sentence: str


@dataclass
class Recorded:
    """What bags say.

    Attributes:
        robot: With the measured fields that contradict its own.
        worlds: To train on: each course with the unseen as free and as wall (NAME-wall), and copies (-1, -2, ...).
        courses: As they were driven.
        fields: What was measured, and of that what contradicts the robot's own.
        remarks: A line for each thing that is wrong or not there, and at the end what to record next time.
    """

    robot: Robot
    worlds: List[World] = field(default_factory=list)
    courses: List[DrivenCourse] = field(default_factory=list)
    fields: Fields = field(default_factory=dict)
    new: Fields = field(default_factory=dict)
    remarks: List[str] = field(default_factory=list)

    def check(self, drives: int = 4, seed: int = 0) -> Check:
        """Drives the recorded parameters through each course, so many times with the unseen as free and as wall.

        They agree where all arrive and the sum of the median times is within BELIEVED of the recorded one, or each
        recorded time is among the simulated ones: the same robot needs now 20 s, now 30 s for one course. Where they do
        not, three times as many are driven, among which a recorded time should be.
        """
        driven: List[List[Drive]] = [[] for _ in self.courses]
        while True:
            for course, each in zip(self.courses, driven):
                missing = list(enumerate(course.worlds * drives))[len(each) :]
                each += [simulated(self.robot, course, world, seed + n) for n, world in missing]
            check = self._compared(driven)
            if check.agrees or drives >= MANY:
                return check
            drives *= 3

    def _compared(self, driven: Sequence[Sequence[Drive]]) -> Check:
        """The recorded drives beside the simulated ones of each course."""
        lines, times, agree = [], [], []
        for course, each in zip(self.courses, driven):
            middle = Drive(*np.median(np.array(each, dtype=np.float64), axis=0).tolist())
            low, high = min(drive.time_s for drive in each), max(drive.time_s for drive in each)
            times.append((course.drive.time_s, middle.time_s))
            agree.append((middle.arrived == 1.0, low <= course.drive.time_s <= high))
            among = f"{low:.1f} to {high:.1f} s in {len(each)} drives"
            lines.append(f"{course.name}: recorded {course.drive}; simulated {middle}; {among}")
        (recorded, needed), (arrived, within) = np.sum(times, axis=0), np.all(agree, axis=0)
        said = f"simulated drives take {needed:.0f} s where the recorded ones take {recorded:.0f} s: "
        if arrived and (abs(needed / recorded - 1.0) <= BELIEVED or within):
            worst = np.max([abs(one / other - 1.0) for other, one in times])
            said += f"believe differences of more than {100.0 * worst:.0f} %, as on single courses"
            return Check(lines, True, said)
        return Check(lines, False, said + "what is found may not hold for this robot")


def simulated(robot: Robot, course: DrivenCourse, world: World, seed: int) -> Drive:
    """A drive in the kinematic simulator with the parameters that the recorded drive had where the robot is."""
    planner = MoveBase(counting_cells(robot.parameters()), planner=CPP_LIKE)
    simulator = sim_bridge.make("kinematic", robot=robot, start_xy=START[0], start_yaw=START[1])
    episode = Episode(simulator, planner, robot, period=PERIOD, record=True, monitor=course.monitored)
    episode.time_limit = min(TIME_LIMIT, 3.0 * course.drive.time_s + 10.0)
    for server, values in course.servers.items():
        known = planner.configuration(server)
        planner.reconfigure(server, {name: value for name, value in values.items() if name in known})
    outcome = episode.reset(world, seed, theta=course.theta[0])
    while not outcome.over:
        away = course.poses[:, :2] - simulator.state.pose[:2]
        outcome = episode.decide(course.theta[np.argmin(np.hypot(*away.T))])
    return Drive.of(np.array(episode.trace.time), np.array(episode.trace.pose), outcome.success)


def read(paths: Sequence[Any], robot: Robot, copies: int = 6) -> Recorded:
    """Reads bags of a robot. What they lack, and bags that cannot be used, are remarks.

    Args:
        paths: Bags, or folders of them.
        robot: Who drove.
        copies: Moved copies of each course, in turn with the unseen as free and as wall.

    Raises:
        BagError: None of them holds a course.
    """
    topics = TopicNames.of(robot)
    drives: List[RecordedDrive] = []
    courses: List[DrivenCourse] = []
    said: Dict[str, List[str]] = {}  # by remark the bags of which it is true
    for path in bags_in(paths):
        try:
            with refused(path):
                drive = RecordedDrive(path, robot, topics)
                while any(drive.name == other.name for other in drives):
                    drive.name += "_"
                courses += drive.courses()
                drive.measure()
        except BagError as error:
            said.setdefault(str(error).partition(": ")[2], []).append(path.name)
            continue
        drives.append(drive)
        for remark in drive.remarks:
            said.setdefault(remark, []).append(path.name)
    remarks = [f"{', '.join(names)}: {remark}" for remark, names in said.items()]
    if any(drive.lacks for drive in drives) or not courses:
        topics = drives[0].bag.topics if drives else topics
        below = [topics.move_base + name for name in ("/goal", "/status", "/result", "/.*parameter_updates")]
        wanted = [topics.scan, topics.odometry, topics.command, "/tf", "/tf_static", *below]
        remarks.append(f"next time: rosbag record -O drive.bag -e {' '.join(wanted)}")
    if not courses:
        raise BagError("; ".join(remarks))
    names = dict.fromkeys(name for drive in drives for name in drive.fields)
    fields = {name: measured.combined([d.fields[name] for d in drives if name in d.fields]) for name in names}
    new = {(of, name): v for (of, name), v in fields.items() if v.contradicts(getattr(getattr(robot, of), name))}
    for (section, name), value in list(new.items()):
        other = replace(robot, **{section: getattr(robot, section).model_copy(update={name: value.value})})
        wrong = [finding for finding in contradictions(other) if finding.severity == "error"]
        if wrong:
            remarks.insert(0, f"measured {section}.{name} {new.pop((section, name))} is left out: {wrong[0]}")
        robot = robot if wrong else other
    rng = np.random.default_rng(0)
    worlds = [*(world for course in courses for world in course.worlds)]
    worlds += [moved(course.worlds[n % 2], n + 1, rng) for course in courses for n in range(copies)]
    return Recorded(robot, worlds, courses, fields, new, remarks)


def moved(world: World, number: int, rng: np.random.Generator) -> World:
    """A copy of a world of cylinders: all in it moved by up to MOVED as waves do, turned, and some mirrored."""
    angles, lengths, phases = rng.uniform(0.0, 2.0 * math.pi, 2), rng.uniform(*WAVES, 2), rng.uniform(0.0, 6.28, 2)
    turn, mirror, course = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0)), world.course
    waves = 2.0 * math.pi / lengths * np.array([np.cos(angles), np.sin(angles)])

    def placed(points):
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        points = points + MOVED / math.sqrt(2.0) * np.sin(points @ waves + phases)
        return np.column_stack(transform_point((0.0, 0.0, turn), mirror * points[:, 0], points[:, 1]))

    def pose(at):
        yaw = at[2] if mirror > 0.0 else math.pi - at[2]
        return (*placed(at[:2])[0].tolist(), normalize_angle(yaw + turn))

    there = replace(course, start=pose(course.start), goal=pose(course.goal), path=placed(course.path))
    circles = np.column_stack([placed(world.cylinders[:, :2]), world.cylinders[:, 2]])
    return replace(world, name=f"{world.name}-{number}", cylinders=circles, course=there)
