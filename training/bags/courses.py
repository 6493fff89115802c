"""What bags of drives with move_base say: their courses as worlds, with moved copies, and fields of the robot.

`./applr tune` searches on these worlds, with this robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Dict, List, Sequence

import numpy as np

from applr_ros1.common.angles import normalize_angle, transform_point
from applr_ros1.robots import Robot, measured
from applr_ros1.robots.check import contradictions
from applr_ros1.robots.measured import Fields
from training.bags import bag
from training.bags.bag import BagError, bags_in, refused
from training.bags.drive import Drive, DrivenCourse
from training.bags.topics import TopicNames
from worlds import World

MOVED_M = 0.1  # by which obstacles, start and goal of copies are moved
WAVES_M = (3.0, 6.0)  # wavelengths of that, so that walls stay whole and passages passable


@dataclass
class Recorded:
    """The content of bags of one robot.

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


def read(paths: Sequence[Any], robot: Robot, copies: int = 6) -> Recorded:
    """Read bags of a robot. What they lack, and bags that cannot be used, are remarks.

    Args:
        paths: Bags, or folders of them.
        robot: Who drove.
        copies: Moved copies of each course, in turn with the unseen as free and as wall.

    Raises:
        BagError: None of them holds a course.
    """
    topics = TopicNames.of(robot)
    recorded, lacks, names = topics, True, set()
    courses: List[DrivenCourse] = []
    measurements: List[Fields] = []
    true_of: Dict[str, List[str]] = {}  # by remark the names of bags
    for path in bags_in(paths):
        try:
            with refused(path):
                drive = Drive(bag.read(path, topics, search=True), robot, topics)
                while drive.name in names:
                    drive.name += "_"
                found = drive.courses()
                drive.measure()
        except BagError as error:
            true_of.setdefault(str(error).partition(": ")[2], []).append(path.name)
            continue
        for remark in drive.remarks:
            true_of.setdefault(remark, []).append(path.name)
        recorded, lacks = (recorded, lacks or drive.lacks) if courses else (drive.bag.topics, drive.lacks)
        names.add(drive.name)
        courses += found
        measurements.append(drive.fields)
    remarks = [f"{', '.join(bags)}: {remark}" for remark, bags in true_of.items()]
    if lacks:
        below = [recorded.move_base + name for name in ("/goal", "/status", "/result", "/.*parameter_updates")]
        wanted = [recorded.scan, recorded.odometry, recorded.command, "/tf", "/tf_static", *below]
        remarks.append(f"next time: rosbag record -O drive.bag -e {' '.join(wanted)}")
    if not courses:
        raise BagError("; ".join(remarks))
    known = dict.fromkeys(name for of_one in measurements for name in of_one)
    fields = {name: measured.combined([of_one[name] for of_one in measurements if name in of_one]) for name in known}
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
    """Return a copy of a world of cylinders, moved by up to MOVED_M as waves do, turned, and some mirrored."""
    angles, lengths, phases = rng.uniform(0.0, 2.0 * math.pi, 2), rng.uniform(*WAVES_M, 2), rng.uniform(0.0, 6.28, 2)
    turn, mirror, course = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0)), world.course
    waves = 2.0 * math.pi / lengths * np.array([np.cos(angles), np.sin(angles)])

    def placed(points):
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        points = points + MOVED_M / math.sqrt(2.0) * np.sin(points @ waves + phases)
        return np.column_stack(transform_point((0.0, 0.0, turn), mirror * points[:, 0], points[:, 1]))

    def pose(at):
        yaw = at[2] if mirror > 0.0 else math.pi - at[2]
        return (*placed(at[:2])[0].tolist(), normalize_angle(yaw + turn))

    there = replace(course, start=pose(course.start), goal=pose(course.goal), path=placed(course.path))
    circles = np.column_stack([placed(world.cylinders[:, :2]), world.cylinders[:, 2]])
    return replace(world, name=f"{world.name}-{number}", cylinders=circles, course=there)
