"""Finds stops while the robot drives, by the rules with which a recorded drive is judged."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, List, Optional, Tuple

import numpy as np

from applr_ros1.drives.bag import UnpackedRow, drive_of, running_goal
from applr_ros1.drives.columns import SECOND, column_of
from applr_ros1.drives.drive import ABORTED, Drive
from applr_ros1.drives.received import Received
from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.black_box.ring import HOLDING
from applr_ros1.why.events import GAVE_UP, SAVED, RobotStop
from applr_ros1.why.fitting import with_velocities
from applr_ros1.why.limits import limits_of, start_values

# Columns by which a stop is found. They are cheap: no scan and no plan is unpacked.
WATCHED = ("odometry", "goals", "results", "changes", "verdicts")
# What every robot does now and then, and no stop
USUAL = (events.WAS_SLOW,)
VIEW_S = 20.0  # time that is looked at [s]
STOP_S = 5.0  # duration from which on an event is a stop [s]
HELD_S = 3.0  # time for which the collision monitor holds a robot that stops [s]
THINNED_S = 0.1  # interval between the odometry messages that are looked at [s]
STATUS_S = 1.0  # longest time between two statuses of move_base [s]
# Time for which stops at one place are told once [s]: as long as a bag, which has them all if an
# application repeats its goal
AGAIN_S = 120.0
PAUSE_S = 1.0  # time after a stop in which another one belongs to it [s]
HELD = "was held by the collision monitor"


class StopDetector:
    """Watches a growing drive, and finds each stop once.

    A stop that goes on is found again if the robot has got another goal, or as soon as it stops in
    another way elsewhere. Within AGAIN_S, those at one place are counted.

    Args:
        robot: Robot that drives, with the parameters of its planner.
    """

    def __init__(self, robot: Robot):
        self.describe(robot)
        self.forget()

    def describe(self, robot: Robot) -> None:
        """Go on with another description of the robot."""
        self._robot = robot
        self._start_values = start_values(robot)

    def forget(self) -> None:
        """Start anew after the clock jumped back."""
        self._messages: Deque[Received] = deque()
        # Parameters and verdicts that left the view still hold.
        self._holding: Dict[Tuple[str, str], Received] = {}
        self._next_odometry = 0  # time from which on the next odometry message is taken [ns]
        self._place = (0.0, 0.0)
        self._running_ids: Dict[str, str] = {}  # running goals of move_base's actions
        self._goal = ""  # identifier of the latest goal
        self._goal_began = -np.inf  # time of its first message [s]
        self._known_until = -np.inf  # time until which a stop that was found has lasted [s]
        self._last_stop: Optional[RobotStop] = None  # latest stop that is to be answered
        self._count = 0  # number of stops at its place so far
        self._counted_until = -np.inf  # time until which the latest of them had lasted [s]

    def wants(self, key: str, time: int) -> bool:
        """Return whether a message of a topic of COLUMNS that came at a time [ns] is looked at."""
        is_thinned = key == "odometry" and time < self._next_odometry
        return key in WATCHED and not is_thinned

    def take(self, message: Received) -> None:
        """Take a message that the detector wants."""
        if message.key == "odometry":
            self._next_odometry = message.recording_time + round(THINNED_S * SECOND)
            for row in message.rows:
                x, y, _ = row["pose"]
                self._place = (x, y)
        if message.key == "goals":
            self._take_goal(message)
        self._messages.append(message)

    def _take_goal(self, message: Received) -> None:
        goal = running_goal(message.rows[-1], self._running_ids)
        if goal and goal != self._goal:
            self._goal = goal
            self._goal_began = message.recording_time / SECOND

    def asked(self, now: float) -> RobotStop:
        """Return the stop that somebody asks to save at a time [s]."""
        return RobotStop(SAVED, now, now, self._place)

    def stop(self, now: float) -> Optional[RobotStop]:
        """Return the stop that began a while before `now` [s], or None. Each is returned once."""
        found_stop = None
        for stop in self._stops(now):
            number = self._number_of(stop)
            if number and found_stop is not None:
                continue  # It is found at the next look.
            if number:
                found_stop = stop._replace(number=number)
            self._known_until = max(self._known_until, stop.end + PAUSE_S)
        if found_stop is not None:
            self._counted_until = found_stop.end
            self._count = found_stop.number
            if found_stop.number == 1:
                self._last_stop = found_stop
        return found_stop

    def _number_of(self, stop: RobotStop) -> int:
        """Return the number of a stop at its place; 0 if it was found before."""
        last_stop = self._last_stop
        if last_stop is None:
            return 1
        is_here = math.dist(stop.place, last_stop.place) <= self._robot.body.size[0]
        # The end of a goal is another stop, although the robot stood there before.
        is_alike = stop.kind == last_stop.kind or stop.kind != GAVE_UP
        is_again = is_here and is_alike and stop.end < last_stop.begin + AGAIN_S
        latest_end = self._counted_until if is_again else last_stop.end
        if stop.begin > self._known_until:
            is_found = True
        elif latest_end < self._goal_began:
            # A robot that was told to go on may still stand there.
            shortest = 0.0 if stop.kind == GAVE_UP else STOP_S
            is_found = stop.end - self._goal_began >= shortest
        else:
            # One in trouble may go from one stop to another without a pause.
            has_left_view = stop.begin > last_stop.begin + VIEW_S
            is_found = not is_here and stop.kind != last_stop.kind and has_left_view
        if not is_found:
            return 0
        return self._count + 1 if is_again else 1

    def _stops(self, now: float) -> List[RobotStop]:
        """Return the stops in view, in order of time."""
        self._drop_before(now - VIEW_S)
        if not self._messages:
            return []
        begin_time = self._messages[0].recording_time
        begin = begin_time / SECOND
        drive = self._drive(begin_time)
        stops = [*self._events(drive, now - begin), *self._given_up(drive)]
        held = self._held(drive, now - begin)
        if held is not None:
            stops.append(held)
        in_time = [stop._replace(begin=begin + stop.begin, end=begin + stop.end) for stop in stops]
        return sorted(in_time, key=lambda stop: stop.begin)

    def _drop_before(self, begin: float) -> None:
        """Drop the messages before a time [s], except for what still holds then."""
        while self._messages and self._messages[0].recording_time < begin * SECOND:
            message = self._messages.popleft()
            if message.key in HOLDING:
                server = str(message.rows[0].get("server", ""))
                self._holding[message.key, server] = message

    def _drive(self, begin_time: int) -> Drive:
        """Return the drive in view, with times since `begin_time` [ns]."""
        unpacked: Dict[str, List[UnpackedRow]] = {}
        for message in (*self._holding.values(), *self._messages):
            elapsed = max(message.recording_time - begin_time, 0) / SECOND
            rows = unpacked.setdefault(column_of(message.key), [])
            rows += [UnpackedRow(elapsed, row) for row in message.rows]
        return drive_of(unpacked, begin_time, self._robot)

    def _events(self, drive: Drive, now: float) -> List[RobotStop]:
        """Return the stops in the motion of a drive until `now` [s]."""
        # Odometry that is silent may have left the view.
        if drive.odometry is None:
            return []
        motion = with_velocities(drive.odometry).motion
        limits = limits_of(drive, motion, self._robot, self._start_values)._replace(end=now)
        stops = []
        for event in events.find(drive, motion, limits):
            if event.kind not in USUAL and event.seconds >= STOP_S:
                stops.append(RobotStop(event.kind, event.begin, event.end, event.place))
        return stops

    def _given_up(self, drive: Drive) -> List[RobotStop]:
        """Return the ends of goals that move_base gave up."""
        stops = []
        for goal in drive.goals:
            if goal.status == ABORTED:
                stops.append(RobotStop(GAVE_UP, goal.end, goal.end, self._place))
        return stops

    def _held(self, drive: Drive, now: float) -> Optional[RobotStop]:
        """Return the time for which the collision monitor has held a robot with a goal, if long."""
        if drive.verdicts is None or not drive.goals or not drive.verdicts.blocked[-1]:
            return None
        blocked_since = now
        was_blocked = False
        for time, is_blocked in zip(drive.verdicts.time.tolist(), drive.verdicts.blocked):
            if is_blocked and not was_blocked:
                blocked_since = time
            was_blocked = is_blocked
        goal = drive.goals[-1]
        begin = max(blocked_since, goal.begin)
        # The status comes five times a second. One that is missing has ended with its node.
        end = now if now - goal.end < STATUS_S else goal.end
        if goal.status or end - begin < HELD_S:
            return None
        return RobotStop(HELD, begin, end, self._place)
