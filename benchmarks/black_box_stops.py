"""Planted stops beside the black box: `python -m benchmarks.black_box_stops`.

Plants one kind of stop at a time in a running stack with a simulated Jackal, once with this
package's move_base and once with a stand-in for the C++ one, and waits for the answer of the black
box. Each stop is a row of docs/results/black_box.csv. Stops during which the planner commands are
driven once more without the black box, to compare the intervals of the commands.
"""

from __future__ import annotations

import csv
import os
import re
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence, Tuple

import actionlib
import numpy as np
import psutil
import rospy
from applr_ros1.msg import Stop
from move_base_msgs.msg import MoveBaseAction

from applr_ros1.planner.parameters.trees import merged
from tests.support.box import Box, spawned
from tests.support.nodes import POSTS, FakeJackal, goal
from tests.support.robots import JACKAL_PARAMETERS, ring
from tests.support.ros import LONGEST, session, wait_for

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "black_box.csv"
MOVE_BASES = {"python": "move_base", "like C++": "tests.support.cpp_move_base"}
PLANNER = "TrajectoryPlannerROS"
SAMPLE_S = 0.25  # interval between two looks at a process [s]
COMPARED_S = 15.0  # time over which intervals of commands are compared [s]
LATEST_S = 40.0  # time after which no stop, and no answer, is expected any more [s]
Circle = Tuple[float, float, float]


class PlantedStop(NamedTuple):
    """Kind of stop.

    Attributes:
        name: Its name in the table.
        reason: Regular expression of the right reason.
        parameters: Values of move_base to replace.
        guesses: Names of parameters one of which a guess names; () if none is expected.
        circles: Obstacles (x, y, radius) [m].
        goal_pose: Goal (x, y, yaw) [m, rad].
        plant: Called with the Jackal when it has driven a metre, or None.
        monitor: Whether the collision monitor follows move_base.
        is_compared: Whether it is driven without the black box, too.
    """

    name: str
    reason: str
    parameters: Dict[str, Any] = {}
    guesses: Tuple[str, ...] = ()
    circles: Sequence[Circle] = POSTS
    goal_pose: Tuple[float, float, float] = (12.0, 0.0, 0.0)
    plant: Optional[Callable[[FakeJackal], None]] = None
    monitor: bool = False
    is_compared: bool = False


JUMP_M = (0.6, 0.8)  # jump of the pose (x, y) [m]
# A block beside the way
BLOCK = [*POSTS, (2.4, -0.8, 0.3)]
# A corridor that becomes narrow, closed behind the robot
FUNNEL = [(-1.2, y, 0.1) for y in np.arange(-1.6, 1.65, 0.15)]
for post_x in np.arange(-1.2, 8.0, 0.15):
    half_width = min(1.6, max(0.55, 1.6 - 0.35 * post_x))
    FUNNEL += [(post_x, half_width, 0.1), (post_x, -half_width, 0.1)]
# A wall across the way, around which the robot must drive
ACROSS = [(2.6, y, 0.1) for y in np.arange(-1.2, 1.25, 0.15)]


def _silence_laser(jackal: FakeJackal) -> None:
    jackal.scans = False


def _close_in(jackal: FakeJackal) -> None:
    """Put a ring of posts around the robot."""
    x, y, _ = jackal.robot.pose
    jackal.put(jackal.robot.pose, ring(x, y, 1.0))


def _hold(jackal: FakeJackal) -> None:
    """Let the base follow no command any more."""
    drive = jackal.robot.drive
    jackal.robot.drive = lambda command, duration: drive(None, duration)


def _jump(jackal: FakeJackal) -> None:
    """Let the pose jump, so that the block seems to stand at the goal."""
    x, y, yaw = jackal.robot.pose
    dx, dy = JUMP_M
    jumped_posts = [(post_x + dx, post_y + dy, radius) for post_x, post_y, radius in BLOCK]
    jackal.put((x + dx, y + dy, yaw), jumped_posts)


def _of_costmaps(**values: Any) -> Dict[str, Any]:
    """Return values of both costmaps."""
    return {"local_costmap": values, "global_costmap": values}


PLANTED = (
    PlantedStop("laser silent", r"there was no scan for", plant=_silence_laser),
    PlantedStop("no plan", r"the global planner finds no path", plant=_close_in),
    PlantedStop(
        "monitor holds",
        r"the collision monitor blocks .*obstacle",
        # The costmaps do not see the wall.
        _of_costmaps(obstacles_layer={"scan": {"obstacle_range": 0.01}}),
        circles=ACROSS,
        monitor=True,
    ),
    PlantedStop("base held", r"the base did not follow its commands", plant=_hold),
    PlantedStop(
        "localisation jump",
        r"the pose jumped by 1\.0 m",
        circles=BLOCK,
        goal_pose=(3.0, 0.0, 0.0),
        plant=_jump,
    ),
    PlantedStop(
        "recovery",
        r"a recovery behaviour ran",
        # Whoever drives counts as oscillating. C++ replaces a recovery by the next plan.
        {
            "oscillation_timeout": 1.5,
            "oscillation_distance": 20.0,
            "planner_frequency": 0.0,
            PLANNER: {"max_vel_theta": 0.6, "min_vel_theta": -0.6},
        },
    ),
    PlantedStop(
        "goal tolerance",
        r"it does not come within xy_goal_tolerance 0\.01 ",
        {PLANNER: {"xy_goal_tolerance": 0.01}},
        goal_pose=(2.0, 0.0, 1.5),
    ),
    PlantedStop(
        "inflation too large",
        r"leads closer to obstacles, which costs too much at occdist_scale",
        _of_costmaps(inflater_layer={"inflation_radius": 2.0, "cost_scaling_factor": 1.0}),
        guesses=("inflation_radius", "cost_scaling_factor", "occdist_scale"),
        circles=FUNNEL,
        is_compared=True,
    ),
    PlantedStop(
        "sim_time too long",
        r"no command faster than .*sim_time 8",
        {PLANNER: {"sim_time": 8.0}},
        guesses=("sim_time",),
        goal_pose=(6.0, 0.0, 0.0),
        is_compared=True,
    ),
    PlantedStop(
        "acc_lim too small",
        r"no command faster than|every faster command leads farther away from the plan",
        {PLANNER: {"acc_lim_x": 0.003}},
        guesses=("acc_lim_x",),
        is_compared=True,
    ),
)


class Row(NamedTuple):
    """Row of the table: what was planted, the answer, and what it cost.

    Attributes:
        move_base: python, or like C++.
        stop: Name of the stop.
        is_right: Whether the reason and the guess are those planted.
        sentence: The answer.
        reproduced: Share of the commands that the replay reproduced.
        begin_s: Time from the begin of the stop to the answer [s].
        answer_s: Time from the stop, when it was found, to the answer [s].
        last_s: The same until the last answer, which may have a guess in addition [s].
        answer_cpu_s: Processor time of the process that answered [s].
        box_percent: Processor share of the node [% of a core].
        box_mb: Memory of the node [MB].
        answer_mb: Largest memory of the process that answered [MB].
        with_ms: 99 % of the intervals of commands are shorter, while the black box answers [ms].
        without_ms: The same without the black box.
        load: Load average of the machine.
    """

    move_base: str
    stop: str
    is_right: bool
    sentence: str
    reproduced: float
    begin_s: float
    answer_s: float
    last_s: float
    answer_cpu_s: float
    box_percent: float
    box_mb: float
    answer_mb: float
    with_ms: Optional[float]
    without_ms: Optional[float]
    load: float


class Watched:
    """Processor time and memory of a process and its children, seen while they run."""

    def __init__(self, pid: int):
        self._process = psutil.Process(pid)
        self._begin_time = time.monotonic()
        self._begin_cpu = self._cpu(self._process)
        self._over = threading.Event()
        self.child_cpu: Dict[int, float] = {}  # processor time by child [s]
        self.child_bytes = 0  # largest memory of a child [bytes]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _cpu(self, process: psutil.Process) -> float:
        times = process.cpu_times()
        return float(times.user + times.system)

    def _run(self) -> None:
        while not self._over.wait(SAMPLE_S):
            for child in self._process.children(recursive=True):
                try:
                    self.child_cpu[child.pid] = self._cpu(child)
                    self.child_bytes = max(self.child_bytes, child.memory_info().rss)
                except psutil.Error:
                    continue  # It has ended.

    @property
    def share(self) -> float:
        """Processor share of the process itself since the begin."""
        elapsed = time.monotonic() - self._begin_time
        return (self._cpu(self._process) - self._begin_cpu) / elapsed

    @property
    def rss(self) -> int:
        """Memory of the process [bytes]."""
        return int(self._process.memory_info().rss)

    def end(self) -> None:
        self._over.set()
        self._thread.join()


class Stack:
    """Jackal, move_base and perhaps the collision monitor, on the way to a planted stop."""

    def __init__(self, planted: PlantedStop, program: str):
        self.planted = planted
        self.jackal = FakeJackal(planted.circles)
        rospy.set_param("/move_base", merged(JACKAL_PARAMETERS, planted.parameters))
        rospy.set_param("/use_sim_time", False)
        self.nodes = []
        command = "cmd_vel"
        if planted.monitor:
            command = "move_base/cmd_vel"
            inputs = "scan:=front/scan", "odom:=odometry/filtered", f"cmd_vel_in:={command}"
            self.nodes.append(session().node("collision_monitor", *inputs))
        move_base = session().node(program, "odom:=odometry/filtered", f"cmd_vel:={command}")
        move_base.until("ready")
        self.nodes.append(move_base)
        self.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        assert self.client.wait_for_server(rospy.Duration(LONGEST))

    def drive(self) -> None:
        """Send the goal, and plant the stop on the way."""
        self.client.send_goal(goal(*self.planted.goal_pose))
        if self.planted.plant is not None:
            wait_for(lambda: self.jackal.robot.pose[0] > 1.0, "the way")
            self.planted.plant(self.jackal)

    def interval_ms(self, begin: float) -> Optional[float]:
        """Return the time under which 99 % of the intervals of commands are [ms].

        None if there are few.
        """
        times = [command.stamp for command in list(self.jackal.commands) if command.stamp > begin]
        if len(times) < 100:
            return None
        return float(1e3 * np.percentile(np.diff(times), 99))

    def end(self) -> None:
        self.client.cancel_goal()
        for node in self.nodes:
            node.end()
        self.jackal.close()


def row_of(planted: PlantedStop, name: str, folder: Path) -> Row:
    """Plant a stop, and return its row."""
    stack = Stack(planted, MOVE_BASES[name])
    box = Box(spawned(session(), folder), folder)
    box.node.until("ready beside")
    watched = Watched(box.node.pid)
    stack.drive()
    _wait(lambda: re.search(r"black box: the robot ", box.node.text))
    found_time = time.time()
    # Intervals are compared over the same time in all drives. The bag comes meanwhile.
    time.sleep(COMPARED_S)
    _wait(lambda: box.answers)
    if not box.answers:
        box.answers.append((found_time, Stop(sentence="no answer")))
    first_time, first_answer = box.answers[0]
    # A second stop may follow at the same place: only answers to the first one count.
    of_first = [
        (answer_time, answer)
        for answer_time, answer in box.answers
        if answer.header.stamp.to_sec() < found_time
    ] or box.answers[:1]
    last_time, answer = of_first[-1]
    guess = answer.parameter.rpartition("/")[2]
    is_right = bool(re.search(planted.reason, answer.reason))
    # A guess may come later than the reason.
    is_right &= not guess or not planted.guesses or guess in planted.guesses
    with_ms = stack.interval_ms(found_time) if planted.is_compared else None
    row = Row(
        move_base=name,
        stop=planted.name,
        is_right=is_right,
        sentence=answer.sentence,
        reproduced=round(answer.reproduced, 3),
        begin_s=round(first_time - answer.header.stamp.to_sec(), 1),
        answer_s=round(first_time - found_time, 1),
        last_s=round(last_time - found_time, 1),
        answer_cpu_s=round(max(watched.child_cpu.values(), default=0.0), 1),
        box_percent=round(100 * watched.share, 1),
        box_mb=round(watched.rss / 1e6),
        answer_mb=round(watched.child_bytes / 1e6),
        with_ms=with_ms and round(with_ms, 1),
        without_ms=None,
        load=round(os.getloadavg()[0], 1),
    )
    watched.end()
    box.node.end()
    stack.end()
    return row


def _wait(condition: Callable[[], Any]) -> None:
    """Wait until a condition holds, at most LATEST_S."""
    due_time = time.monotonic() + LATEST_S
    while not condition() and time.monotonic() < due_time:
        time.sleep(0.05)


def interval_without(planted: PlantedStop, name: str) -> Optional[float]:
    """Return the 99 % interval of commands [ms] in a planted stop without a black box."""
    stack = Stack(planted, MOVE_BASES[name])
    stack.drive()
    time.sleep(10.0)
    begin = time.time()
    time.sleep(COMPARED_S)
    interval = stack.interval_ms(begin)
    stack.end()
    return interval and round(interval, 1)


def main() -> None:
    session()
    with tempfile.TemporaryDirectory() as folder, RESULTS.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(Row._fields)
        for name in MOVE_BASES:
            for planted in PLANTED:
                row = row_of(planted, name, Path(folder) / f"{planted.name}, {name}")
                if planted.is_compared:
                    row = row._replace(without_ms=interval_without(planted, name))
                print(*row, sep=" | ", flush=True)
                table.writerow(row)


if __name__ == "__main__":
    main()
