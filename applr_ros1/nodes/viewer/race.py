"""The viewer's tab Race: drives are timed and kept, and drive again as ghosts; a race of methods and its verdict."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
import rospy
from std_msgs.msg import Bool

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.drives.comparison import compare
from applr_ros1.robots import Robot

from .panel import ARRIVED, UNDER_WAY, WORDS
from .pilot import METHODS, Pilot
from .shapes import PALETTE, Lines, Model
from .world import WorldTab

COLLISION = "sim_bridge/collision"
LIMIT = 100.0  # s of ROS time for one drive of a race, and what one that does not arrive counts as
CONTACT = 5.0  # s that a contact counts as
PATIENCE = 20.0  # wall seconds for each thing that a race waits for
SETTLING = 1.0  # wall seconds between a reset and the next goal: the costmaps see the world again
BREAK = 2.0  # wall seconds between two rounds of the ghosts
TABLE = 12  # drives in the table
NOBODY, THEN = "nobody", ", then "


@dataclass
class TimedDrive:
    """One drive to a goal. who: set the parameters; rows: (seconds since its start, x, y, yaw) in the fixed frame."""

    who: str
    world: str
    began: float
    of_course: bool
    rows: List[Tuple[float, float, float, float]] = field(default_factory=list)
    ended: str = ""
    seconds: float = 0.0
    touched: bool = False

    @property
    def arrived(self) -> bool:
        """Whether it ended at its goal."""
        return self.ended == ARRIVED

    @property
    def score(self) -> float:
        """Its time [s], LIMIT where it did not arrive, and CONTACT more where it touched something."""
        return (self.seconds if self.arrived else LIMIT) + CONTACT * self.touched


def verdict(drives: Sequence[TimedDrive]) -> str:
    """Who was best by how much, in one sentence; "" without two. drives: of different methods in the same world."""
    if len(drives) < 2:
        return ""
    best, other = sorted(drives, key=lambda drive: drive.score)[:2]
    if not best.arrived:
        return "nobody arrived"
    text = compare([best.score], [other.score]).sentence(best.who, other.who)
    for drive in (best, other):
        text += f", {drive.who} did not arrive" * (not drive.arrived)
        text += f", {drive.who} touched something" * drive.touched
    return text


class RaceEnded(Exception):
    """A race that does not go on."""


class Ghost:
    """A drive that is driven again: robot, trail and label, in a colour of who set the parameters."""

    def __init__(self, scene: Any, robot: Robot, drive: TimedDrive, name: str):
        self.drive, self._rows = drive, np.array(drive.rows)
        names = list(METHODS.values())
        colour = PALETTE[names.index(drive.who)] if drive.who in names else (90, 90, 90)
        self.remove = scene.add_frame(name, show_axes=False).remove
        self._model = Model(scene, name + "/robot", robot, colour, 0.6)
        scene.add_label(name + "/robot/label", f"{drive.who} {drive.seconds:.1f} s", position=(0.0, 0.0, 0.5))
        Lines(scene, name + "/trail", colour, 0.02).path(self._rows[:, 1:3], 0.01)

    def put(self, seconds: float) -> None:
        """Where it was at a time after its start."""
        k = max(0, int(np.searchsorted(self._rows[:, 0], seconds, "right")) - 1)
        self._model.put(tuple(self._rows[k, 1:].tolist()))


class RaceTab:
    """Keeps this visit's drives. methods: {what the page calls it: method}, what there is for this robot."""

    def __init__(self, server: Any, world: WorldTab, pilot: Pilot, methods: Dict[str, str]):
        self._scene, self._world, self._pilot, self._methods = server.scene, world, pilot, methods
        self.drives: List[TimedDrive] = []
        self._goals: Set[str] = set()  # ids of those that were timed
        self._ghosts: Dict[str, Ghost] = {}  # by who set the parameters
        self._now: Optional[TimedDrive] = None
        self._ended = 0.0
        self.running = threading.Event()
        gui, names = server.gui, list(methods)
        self._choices = [
            gui.add_dropdown(place, (NOBODY, *names), initial_value=chosen)
            for place, chosen in (("first", names[0]), ("second", names[-2]), ("third", NOBODY))
        ]
        gui.add_button("race").on_click(lambda _: self._begin())
        self._verdict = gui.add_markdown("")
        self._table = gui.add_markdown("No drive yet.")

    def look(self, pose: Optional[Pose], goal: Any) -> bool:
        """Time the present drive and move the ghosts. goal: its status. Returns whether a new drive has begun."""
        now, who = rospy.get_time(), self._pilot.who
        touched = any(message.data for message in self._world.listener.fresh(COLLISION, Bool))
        under_way = goal is not None and goal.status in UNDER_WAY
        begun = under_way and goal.goal_id.id not in self._goals
        if begun:
            self._finish("replaced")
            self._goals.add(goal.goal_id.id)
            self._now = TimedDrive(who, self._world.name, now, goal.goal_id.id == self._world.course_goal)
        drive = self._now
        if drive is not None:
            drive.seconds, drive.touched = now - drive.began, drive.touched or touched
            if who not in drive.who.split(THEN):
                drive.who = who if drive.who == NOBODY else drive.who + THEN + who
            if pose is not None:
                drive.rows.append((drive.seconds, *pose))
            if drive.of_course and self._is_done(pose):
                self._finish(ARRIVED)
                self._world.stop()
            elif goal is not None and not under_way:
                self._finish(WORDS[goal.status])
        self._move_ghosts()
        return begun

    @property
    def result(self) -> str:
        """How the last drive ended; "" before the first, and while one is under way."""
        if self._now is not None or not self.drives:
            return ""
        last = self.drives[-1]
        return f"{last.ended} after {last.seconds:.1f} s" + ", touched something" * last.touched

    def go(self, pose: Optional[Pose]) -> None:
        """Drive the course; a robot at its end goes back to the start first."""
        if self._is_done(pose) and self._world.reset():
            time.sleep(SETTLING)
        self._world.drive_course()

    def _is_done(self, pose: Optional[Pose]) -> bool:
        """Whether the robot is at the end of the course."""
        place, course = self._world.listener.frame_pose("world"), self._world.course
        at = transform_point(inverse(place), *pose[:2]) if place and pose else None
        return at is not None and course is not None and course.done(*at)

    def _finish(self, how: str) -> None:
        drive, self._now = self._now, None
        if drive is None:
            return
        drive.ended, self._ended = how, time.monotonic()
        self.drives.append(drive)
        lines = ["| world | parameters by | time | |", "|---|---|---:|---|"]
        for one in reversed(self.drives[-TABLE:]):  # the columns of the page's tables have no space between them
            ended = one.ended + ", touched something" * one.touched
            lines.append(f"| {one.world} | &nbsp;{one.who} | {one.seconds:.1f}&nbsp;s | &nbsp;{ended} |")
        self._table.content = "\n".join(lines)

    def _move_ghosts(self) -> None:
        """The newest drive of each method in this world: beside the present drive, or all together."""
        newest = {one.who: one for one in self.drives if one.world == self._world.name and one.rows}
        for who in [who for who, ghost in self._ghosts.items() if newest.get(who) is not ghost.drive]:
            self._ghosts.pop(who).remove()
        for who, drive in newest.items():
            if who not in self._ghosts:
                self._ghosts[who] = Ghost(self._scene, self._world.robot, drive, f"/ghosts/{self.drives.index(drive)}")
        longest = max((drive.seconds for drive in newest.values()), default=0.0) + BREAK
        at = self._now.seconds if self._now is not None else (time.monotonic() - self._ended) % longest
        for ghost in self._ghosts.values():
            ghost.put(at)

    def _begin(self) -> None:
        if not self.running.is_set():
            self.running.set()
            threading.Thread(target=self._run, daemon=True).start()

    def end(self) -> None:
        """End a race and every drive."""
        self.running.clear()
        self._world.stop()

    def _run(self) -> None:
        """The chosen methods one after the other, each from the start. node.py draws and times meanwhile."""
        before, text = len(self.drives), "The race ended early."
        self._verdict.content = "Under way."
        with contextlib.suppress(RaceEnded):
            for choice in self._choices:
                if choice.value != NOBODY:
                    self._drive(self._methods[choice.value])
            text = verdict(self.drives[before:]) or "Nobody to compare with."
        self.running.clear()
        self._verdict.content = f"**{text}**"
        self._world.say(text)

    def _drive(self, method: str) -> None:
        """From the start to the end of the course."""
        if not self._world.reset() or not self._pilot.choose(method):
            raise RaceEnded
        self._wait(lambda: self._now is None, PATIENCE)
        time.sleep(SETTLING)
        goal = self._world.drive_course()
        self._wait(lambda: goal in self._goals, PATIENCE if goal else 0.0)
        began = rospy.get_time()
        self._wait(lambda: self._now is None or rospy.get_time() - began > LIMIT)
        self._world.stop()
        self._wait(lambda: self._now is None, PATIENCE)

    def _wait(self, condition: Callable[[], bool], seconds: float = float("inf")) -> None:
        """Until something is true. Raises RaceEnded when wall time is over or the race is ended before."""
        until = time.monotonic() + seconds
        while self.running.is_set() and not rospy.is_shutdown() and time.monotonic() < until:
            if condition():
                return
            time.sleep(0.05)
        raise RaceEnded
