"""Recorder of simulated drives: writes a bag with the topics of the stack, without ROS."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from rosbags.typesys import get_types_from_msg

from applr_ros1.policy.observation import FARTHEST_M, beginning
from tests.support import ROOT
from training.bags.writer import BagWriter
from training.env.episode import Episode
from training.env.outcome import Outcome

PAUSE = 5.0  # time between two courses of a bag [s]
PLOTTED = 8  # number of fields of Parameters.msg besides its lists
ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = 1, 2, 3, 4
_OTHERS = {
    "move_base_msgs/msg/MoveBaseActionResult": "std_msgs/Header header\nactionlib_msgs/GoalStatus status\n"
    "move_base_msgs/MoveBaseResult result\n",
    "move_base_msgs/msg/MoveBaseResult": "",
}


class StackWriter(BagWriter):
    """BagWriter that also writes the topics of move_base and the applr node, with the same arguments."""

    def __init__(self, *args: Any, **more: Any):
        super().__init__(*args, **more)
        for name, text in _OTHERS.items():
            self.store.register(get_types_from_msg(text, name))

    def contact(self, time: float) -> None:
        """Write a contact of the robot."""
        self._put(self.topics.collision, "std_msgs/msg/Bool", time, True)

    def status(self, time: float, goal_id: str, running: bool = True, ended: int = 0) -> None:
        """Write the status of move_base's action: a goal that is active, or has ended with the status `ended`."""
        pursued = [self._status(goal_id, ACTIVE if running else ended)] if running or ended else []
        topic = self.topics.move_base + "/status"
        self._put(topic, "actionlib_msgs/msg/GoalStatusArray", time, self._header(time, ""), pursued)

    def result(self, time: float, goal_id: str, status: int) -> None:
        """Write the result of a goal, with an actionlib status."""
        fields = (
            self._header(time, ""),
            self._status(goal_id, status),
            self._make("move_base_msgs/msg/MoveBaseResult", 0),
        )
        self._put(self.topics.move_base + "/result", "move_base_msgs/msg/MoveBaseActionResult", time, *fields)

    def decision(self, time, number, goal, seen, before, after=None):
        """Write msg/Decision.msg with a Seen in the odometry frame and {name: value} before and after the decision.

        Without `after`, write the end of the course.
        """
        kinds = [f"applr_ros1/msg/{name}" for name in ("Parameters", "Movers", "Decision")]
        if kinds[-1] not in self.store.types:
            for kind in kinds:
                text = (ROOT / "msg" / (kind.rpartition("/")[2] + ".msg")).read_text(encoding="utf-8")
                self.store.register(get_types_from_msg(text, kind))
        header = self._header(time, self.robot.frames.odom)
        sets = [
            self._make(kinds[0], header, list(of), np.array(list(of.values())), np.ones(len(of)), *[np.nan] * PLOTTED)
            for of in (before, after or {})
        ]
        movers = self._make(kinds[1], header, *seen.movers.T.copy(), np.zeros(len(seen.movers)))
        stamps, places = [self._time(time)] * 3, map(float, (*seen.pose, *seen.twist, *seen.goal))
        plan = beginning(seen.plan, seen.pose, FARTHEST_M * self.robot.world_scale).T.copy()
        fields = header, number, goal, seen.time, *stamps, *places, *seen.scan[1:], seen.scan[0], *plan, movers
        topic = self.topics.course_end if after is None else self.topics.decision
        self._put(topic, kinds[2], time, *fields, *sets, "")

    def _status(self, goal_id, status):
        identity = self._make("actionlib_msgs/msg/GoalID", self._time(0.0), goal_id)
        return self._make("actionlib_msgs/msg/GoalStatus", identity, status, "")


class RecordingEpisode(Episode):
    """Episode that records its courses, one after the other, with a StackWriter."""

    def __init__(self, simulator, move_base, writer: BagWriter, **options):
        super().__init__(simulator, move_base, writer.robot, **options)
        self.writer = writer
        self.courses = self.decisions = 0
        self._ahead = 1.0  # offset from the simulator's time, which restarts with each course [s]
        self._written: Optional[float] = None  # time of the latest scan in the bag [s]

    def reset(self, world, seed: int, theta=None) -> Outcome:
        """Begin a course and send its goal on the recorded action topic."""
        if self.courses:
            self._ahead += self.simulator.state.time + PAUSE
        self._goal_id = ""  # no messages before the goal is sent
        outcome = super().reset(world, seed, theta)
        self.courses += 1
        self._goal_id = f"course {self.courses} in {world.name}"
        self.writer.goal(self._now, self.goal)
        self._look()
        return outcome

    def decide(self, theta) -> Outcome:
        """Drive one decision period and write the messages that the nodes would have published."""
        now, seen, before = self._now, self.seen(), self.outcome.theta
        outcome = super().decide(theta)
        sets = map(self.space.as_dict, (before, outcome.theta))
        self.writer.decision(now, self.decisions, self._goal_id, seen, *sets)
        self.decisions += 1
        self._look()
        if outcome.over:
            self.writer.decision(
                self._now, self.decisions, self._goal_id, self.seen(), self.space.as_dict(outcome.theta)
            )
            status = SUCCEEDED if outcome.success else ABORTED if outcome.aborted else PREEMPTED
            self.writer.result(self._now, self._goal_id, status)
            self.writer.status(self._now, self._goal_id, running=False)
        return outcome

    @property
    def _now(self) -> float:
        return self._ahead + self.simulator.state.time

    def _cycle(self):
        before, now, ranges = self.simulator.state, self._now, self._ranges
        cycle, state = super()._cycle()
        if self._goal_id:
            if self._written != now:  # The scan of a decision at the same time has other noise.
                self.writer.odometry(now, before.odom_pose, before.odom_twist)
                if self._ranges is not ranges:
                    self.writer.scan(now, self._ranges)
            if state.contact:
                self.writer.contact(self._ahead + state.time)
        return cycle, state

    def _look(self) -> None:
        """Write the inputs of the next decision."""
        now, state = self._now, self.simulator.state
        self.writer.status(now, self._goal_id)
        self.writer.odometry(now, state.odom_pose, state.odom_twist)
        self.writer.scan(now, self._scanned)
        self._written = now
