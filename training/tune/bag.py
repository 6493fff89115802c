"""The recorded drives of bags in the simulator: how far what is found there may be believed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

import sim_bridge
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json, sha256, write_json
from applr_ros1.common.progress import announced
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots import Robot
from applr_ros1.robots.measured import Fields, Value
from training.bags.bag import bags_in
from training.bags.courses import Recorded
from training.bags.drive import DrivenCourse, Pace
from training.env.episode import TIME_LIMIT, Episode, counting_cells
from training.trials.runner import content
from worlds import World

START = 0.02, 0.02  # [m, rad] as well as scans tell where a drive began
BELIEVED = 0.2  # share of the recorded time by which the simulated one may differ
MANY = 9  # drives of a course after which simulated and recorded times agree or not
PERIOD_S = 1.0  # between two looks at the recorded parameters


class Found(NamedTuple):
    """The content of bags as a search uses it.

    lines: what to print of it. new: measured fields that contradict the robot's. halves: files of worlds for the search
    and for the verdict. agrees, sentence: of the check.
    """

    lines: List[str]
    new: Fields
    halves: Tuple[List[str], List[str]]
    agrees: bool
    sentence: str


def key(paths: Sequence[Any], robot: Robot, *more: Any) -> str:
    """Return a checksum of what the content of bags depends on: names, sizes and times of their files, and the robot.

    Raises:
        BagError: a path does not exist, or there are no bags.
    """
    files = [file for bag in bags_in(paths) for file in (sorted(bag.iterdir()) if bag.is_dir() else [bag])]
    states = [(file.parent.name, file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return sha256(states, content(robot), *more)


def keep(path: Path, keys: Sequence[str], found: Found) -> None:
    """Write what was found in bags for runs with one of these keys."""
    new = [[section, name, *value] for (section, name), value in found.new.items()]
    write_json(path, {"keys": list(keys), "found": [*found[:1], new, *found[2:]]})


def kept(path: Path, key: str) -> Optional[Found]:
    """Return what was found in bags by an earlier run with this key; None where that is not there as a whole."""
    try:
        stored = read_json(path)
        if key not in stored["keys"]:
            return None
        lines, new, halves, agrees, sentence = stored["found"]
        fields = {(section, name): Value(*value) for section, name, *value in new}
        there = all(Path(file).exists() for half in halves for file in half)
        return Found(lines, fields, (halves[0], halves[1]), agrees, sentence) if there else None
    except (ApplrError, LookupError, TypeError, ValueError):  # none, or damaged: it is found anew
        return None


class Check(NamedTuple):
    """The recorded parameters in the simulator: a line a course, whether all agree, how far to believe the rest."""

    lines: List[str]
    agrees: bool
    sentence: str


def check(recorded: Recorded, drives: int = 4, seed: int = 0) -> Check:
    """Drive the recorded parameters through each course, so many times with the unseen as free and as wall.

    They agree where all arrive and the sum of the median times is within BELIEVED of the recorded one, or each
    recorded time is among the simulated ones: the same robot needs now 20 s, now 30 s for one course. Where they do
    not, three times as many are driven, among which a recorded time should be.
    """
    driven: List[List[Pace]] = [[] for _ in recorded.courses]
    while True:
        for course, each in zip(recorded.courses, driven):
            missing = list(enumerate(course.worlds * drives))[len(each) :]
            what = f"driving the parameters of {course.name} through its course {len(missing)} times"
            with announced(what, partial(print, flush=True)):
                each += [simulated(recorded.robot, course, world, seed + n) for n, world in missing]
        found = _compared(recorded.courses, driven)
        if found.agrees or drives >= MANY:
            return found
        drives *= 3


def _compared(courses: Sequence[DrivenCourse], driven: Sequence[Sequence[Pace]]) -> Check:
    """Compare the recorded drive of each course with the simulated ones."""
    lines, times, within, short = [], [], [], []
    for course, each in zip(courses, driven):
        middle = Pace(*np.median(np.array(each, dtype=np.float64), axis=0).tolist())
        low, high = min(pace.time_s for pace in each), max(pace.time_s for pace in each)
        times.append((course.pace.time_s, middle.time_s))
        within.append(low <= course.pace.time_s <= high)
        arrived = sum(bool(pace.arrived) for pace in each)
        if 2 * arrived <= len(each):
            short.append(f"on {course.name} {arrived} of {len(each)} simulated drives arrive")
        among = f"{low:.1f} to {high:.1f} s in {len(each)} drives"
        lines.append(f"{course.name}: recorded {course.pace}; simulated {middle}; {among}")
    recorded, needed = np.sum(times, axis=0)
    shares = [one / other - 1.0 for other, one in times]
    worst = int(np.argmax(np.abs(shares)))
    sentence = f"simulated drives take {needed:.0f} s where the recorded ones take {recorded:.0f} s"
    late = bool(abs(needed / recorded - 1.0) > BELIEVED) and not all(within)
    if not (late or short):
        off = f"believe differences of more than {100.0 * abs(shares[worst]):.0f} %, as on single courses"
        return Check(lines, True, f"{sentence}: {off}")
    why = f"{sentence}, {100.0 * (needed / recorded - 1.0):+.0f} % (at most {100.0 * BELIEVED:.0f} % are believed)"
    if len(courses) > 1:
        why += f", most on {courses[worst].name}: {times[worst][1]:.0f} s for {times[worst][0]:.0f} s"
    why = ", and ".join([*short, *[why] * late])
    return Check(lines, False, f"{why}: what is found may not hold for this robot")


def simulated(robot: Robot, course: DrivenCourse, world: World, seed: int) -> Pace:
    """Return the pace of a simulated drive with the parameters that the recorded one had where the robot is."""
    planner = MoveBase(counting_cells(robot.parameters()), planner=CPP_LIKE)
    simulator = sim_bridge.make("kinematic", robot=robot, start_xy=START[0], start_yaw=START[1])
    episode = Episode(simulator, planner, robot, period=PERIOD_S, record=True, monitor=course.monitored)
    episode.time_limit = min(TIME_LIMIT, 3.0 * course.pace.time_s + 10.0)
    for server, values in course.servers.items():
        known = planner.configuration(server)
        planner.reconfigure(server, {name: value for name, value in values.items() if name in known})
    outcome = episode.reset(world, seed, theta=course.theta[0])
    while not outcome.over:
        away = course.poses[:, :2] - simulator.state.pose[:2]
        outcome = episode.decide(course.theta[np.argmin(np.hypot(*away.T))])
    return Pace.of(np.array(episode.trace.time), np.array(episode.trace.pose), outcome.success)
