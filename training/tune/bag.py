"""The recorded drives of bags in the simulator: how far what is found there may be believed."""

from __future__ import annotations

from typing import List, NamedTuple, Sequence

import numpy as np

import sim_bridge
from applr_ros1.common.progress import announced
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots import Robot
from training.bags.courses import Recorded
from training.bags.drive import DrivenCourse, Pace
from training.env.episode import TIME_LIMIT, Episode, counting_cells
from worlds import World

START = 0.02, 0.02  # [m, rad] as well as scans tell where a drive began
BELIEVED = 0.2  # share of the recorded time by which the simulated one may differ
MANY = 9  # drives of a course after which simulated and recorded times agree or not
PERIOD_S = 1.0  # between two looks at the recorded parameters


def _say(line: str) -> None:
    print(line, flush=True)


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
            with announced(f"driving the parameters of {course.name} through its course {len(missing)} times", _say):
                each += [simulated(recorded.robot, course, world, seed + n) for n, world in missing]
        found = _compared(recorded.courses, driven)
        if found.agrees or drives >= MANY:
            return found
        drives *= 3


def _compared(courses: Sequence[DrivenCourse], driven: Sequence[Sequence[Pace]]) -> Check:
    """Compare the recorded drive of each course with the simulated ones."""
    lines, times, agree, strayed = [], [], [], []
    for course, each in zip(courses, driven):
        middle = Pace(*np.median(np.array(each, dtype=np.float64), axis=0).tolist())
        low, high = min(pace.time_s for pace in each), max(pace.time_s for pace in each)
        times.append((course.pace.time_s, middle.time_s))
        agree.append((middle.arrived == 1.0, low <= course.pace.time_s <= high))
        if middle.arrived < 1.0:
            strayed.append(f"{sum(not pace.arrived for pace in each)} of {len(each)} on {course.name}")
        among = f"{low:.1f} to {high:.1f} s in {len(each)} drives"
        lines.append(f"{course.name}: recorded {course.pace}; simulated {middle}; {among}")
    (recorded, needed), (arrived, within) = np.sum(times, axis=0), np.all(agree, axis=0)
    sentence = f"simulated drives take {needed:.0f} s where the recorded ones take {recorded:.0f} s: "
    if arrived and (abs(needed / recorded - 1.0) <= BELIEVED or within):
        worst = np.max([abs(one / other - 1.0) for other, one in times])
        sentence += f"believe differences of more than {100.0 * worst:.0f} %, as on single courses"
        return Check(lines, True, sentence)
    why = f"they do not arrive in {', '.join(strayed)}"
    if not strayed:
        apart = [abs(one / other - 1.0) for other, one in times]
        why = f"{100.0 * abs(needed / recorded - 1.0):.0f} % are between, {100.0 * BELIEVED:.0f} % are believed, and "
        why += f"{courses[int(np.argmax(apart))].name} is farthest off with {100.0 * max(apart):.0f} %"
    return Check(lines, False, f"{sentence}{why}; what is found may not hold for this robot")


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
