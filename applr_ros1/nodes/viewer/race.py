"""The viewer's tab Race: drives are timed and kept, and drive again as ghosts; the same course by several methods."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus
from std_msgs.msg import Bool

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.robots import Robot

from .listening import Listener
from .panel import METHODS, WORDS, goal_status
from .pilot import HAND, Pilot
from .shapes import Lines, Model
from .world import WorldTab

COLLISION = "sim_bridge/collision"
TOPICS = {COLLISION: Bool}
UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING)
LIMIT = 100.0  # s of ROS time for one drive of a race
PATIENCE = 10.0  # wall seconds for each thing that a race waits for
SETTLING = 1.0  # wall seconds between a reset and the next goal: the costmaps see the world again
BREAK = 2.0  # wall seconds between two rounds of the ghosts
TABLE = 12  # drives in the table
NOBODY = "nobody"
COLOURS = ((47, 111, 222), (217, 72, 15), (43, 138, 62), (156, 54, 181), (90, 90, 90))  # of ghosts, by method


class Drive:
    """One drive to a goal. rows: (seconds since its start, x, y, yaw) in the fixed frame."""

    def __init__(self, goal: str, method: str, world: str, began: float):
        self.goal, self.method, self.world, self.began = goal, method, world, began
        self.rows: List[Tuple[float, float, float, float]] = []
        self.ended, self.seconds, self.touched = "", 0.0, False

    @property
    def by(self) -> str:
        """The methods as the page calls them."""
        return ", then ".join(METHODS.get(name, name) or "nobody" for name in self.method.split(" + "))


class Ghost:
    """A drive that is driven again: robot, trail and time."""

    def __init__(self, scene: Any, robot: Robot, drive: Drive, name: str):
        self.drive = drive
        methods = list(METHODS)
        colour = COLOURS[methods.index(drive.method) if drive.method in methods else -1]
        self._model = Model(scene, name, robot, colour, 0.4)
        scene.add_label(name + "/label", "%s %.1f s" % (drive.by, drive.seconds), position=(0.0, 0.0, 0.6))
        self._trail = Lines(scene, name + "_trail", colour, 0.02)
        self._rows = np.array(drive.rows)

    def put(self, seconds: float, shown: bool) -> None:
        """Where it was at a time after its start."""
        k = max(0, int(np.searchsorted(self._rows[:, 0], seconds, "right")) - 1)
        self._model.put(tuple(self._rows[k, 1:].tolist()) if shown else None)
        if shown != self._trail.shown or not self._trail.drawn:
            self._trail.shown = shown
            self._trail.path(self._rows[:, 1:3], 0.01)

    def remove(self) -> None:
        """Take it off the scene."""
        self._model.remove()
        self._trail.remove()


class RaceTab:
    """Keeps this visit's drives.

    Args:
        server: viser's; elements are added where its gui's context is.
        robot: Description of the robot.
        listener: Has TOPICS and the panel's.
        pilot: Sets the methods.
        world: Sends goals and puts the robot back.
        methods: What there is for this robot, as in METHODS.
    """

    def __init__(
        self, server: Any, robot: Robot, listener: Listener, pilot: Pilot, world: WorldTab, methods: Tuple[str, ...]
    ):
        self._scene, self._robot, self._listener, self._pilot, self._world = server.scene, robot, listener, pilot, world
        self.drives: List[Drive] = []
        self._ghosts: Dict[str, Ghost] = {}  # by method
        self._now: Optional[Drive] = None
        self._ended = 0.0
        self.running = threading.Event()
        gui, names = server.gui, [METHODS[method] for method in methods]
        self._choices = [
            gui.add_dropdown(place, (NOBODY, *names), initial_value=chosen)
            for place, chosen in (("first", names[0]), ("second", names[-2]), ("third", NOBODY))
        ]
        gui.add_button("race").on_click(lambda _: self._begin())
        gui.add_button("end the race").on_click(lambda _: self._end())
        self._table = gui.add_markdown("No drive yet.")

    def look(self, pose: Optional[Pose], show_ghosts: bool) -> bool:
        """Time the present drive and move the ghosts. Returns whether a new drive has begun."""
        goal, now = goal_status(self._listener), rospy.get_time()
        touched = any(message.data for message in self._listener.fresh(COLLISION))
        begun = goal is not None and goal.status in UNDER_WAY and self._is_new(goal.goal_id.id)
        if begun:
            if self._now is not None:
                self._finish("replaced")
            self._now = Drive(goal.goal_id.id, self._pilot.method, self._world.name, now)
        drive = self._now
        if drive is not None:
            drive.seconds, drive.touched = now - drive.began, drive.touched or touched
            if self._pilot.method not in drive.method.split(" + "):
                drive.method += " + " + self._pilot.method
            if pose is not None:
                drive.rows.append((drive.seconds, *pose))
            if self._is_done(drive, pose):
                self._finish("finished")
                self._world.stop()
            elif goal is not None and goal.status not in UNDER_WAY:
                self._finish(WORDS.get(goal.status, "ended"))
        self._move_ghosts(show_ghosts)
        return begun

    def _is_new(self, goal: str) -> bool:
        return goal not in [drive.goal for drive in self.drives[-TABLE:] + ([self._now] if self._now else [])]

    def _is_done(self, drive: Drive, pose: Optional[Pose]) -> bool:
        """Whether a drive of the course is at its end."""
        place, course = self._listener.place("world"), self._world.course
        if drive.goal != self._world.course_goal or course is None or not (place and pose):
            return False
        return course.done(*transform_point(inverse(place), pose[0], pose[1]))

    def _finish(self, how: str) -> None:
        drive, self._now = self._now, None
        drive.ended, self._ended = how, time.monotonic()
        self.drives.append(drive)
        lines = ["| world | parameters by | time | |", "|---|---|---:|---|"]
        for one in reversed(self.drives[-TABLE:]):
            touched = ", touched something" if one.touched else ""
            lines.append("| %s | %s | %.1f s | %s%s |" % (one.world, one.by, one.seconds, one.ended, touched))
        self._table.content = "\n".join(lines)

    def _move_ghosts(self, shown: bool) -> None:
        """The newest drive of each method in this world: beside the present drive, or all together."""
        newest = {one.method: one for one in self.drives if one.world == self._world.name and one.rows}
        for method in [name for name, ghost in self._ghosts.items() if newest.get(name) is not ghost.drive]:
            self._ghosts.pop(method).remove()
        for method, drive in newest.items():
            if method not in self._ghosts:
                name = "/ghost%d" % self.drives.index(drive)
                self._ghosts[method] = Ghost(self._scene, self._robot, drive, name)
        longest = max((drive.seconds for drive in newest.values()), default=0.0) + BREAK
        at = self._now.seconds if self._now is not None else (time.monotonic() - self._ended) % longest
        for ghost in self._ghosts.values():
            ghost.put(at, shown)

    # -- a race ------------------------------------------------------------------------------------
    def _begin(self) -> None:
        if not self.running.is_set():
            self.running.set()
            threading.Thread(target=self._race, daemon=True).start()

    def _end(self) -> None:
        self.running.clear()
        self._world.stop()

    def _race(self) -> None:
        """The chosen methods one after the other, each from the start; node.py draws and times meanwhile."""
        try:
            names = [choice.value for choice in self._choices if choice.value != NOBODY]
            for method in [name for shown in names for name, words in METHODS.items() if words == shown]:
                problem = self._world.reset() or self._hand_to(method)
                if problem or not self._wait(lambda: self._now is None, PATIENCE):
                    return
                time.sleep(SETTLING)
                goal = self._world.drive_course()
                if not goal or not self._wait(lambda goal=goal: not self._is_new(goal), PATIENCE):
                    return
                began = rospy.get_time()
                if not self._wait(lambda began=began: self._now is None or rospy.get_time() - began > LIMIT):
                    return
                self._world.stop()
        finally:
            self.running.clear()

    def _hand_to(self, method: str) -> str:
        problem = self._pilot.hold() if method == HAND else self._pilot.hand_to(method)
        if problem:
            self._world.say(problem)
        return problem

    def _wait(self, condition: Callable[[], bool], seconds: float = float("inf")) -> bool:
        """Whether something becomes true before wall time is over and the race is ended."""
        until = time.monotonic() + seconds
        while not condition():
            if not self.running.is_set() or rospy.is_shutdown() or time.monotonic() > until:
                return False
            time.sleep(0.05)
        return self.running.is_set()
