"""Rules by which the drive along a course ends.

A drive asks after each control cycle, and for a stall and the time limit after each decision
period (simulate.py).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional

from applr_ros1.common.angles import Pose
from applr_ros1.drives.drive import ABORTED, FLIPPED, REACHED, STALLED, TIMED_OUT, TOUCHED
from applr_ros1.drives.end_reasons import ended_early
from applr_ros1.stack.simulated import Tick
from worlds import Course

TIME_LIMIT = 100.0  # duration after which a trial counts as failed [s]


class CourseEnd(NamedTuple):
    """End of a course: status of its Goal (drive.py), and reason in words."""

    status: str
    reason: str


class PlannerResult(NamedTuple):
    """Result of a goal by move_base: whether it was reached, and a message."""

    has_succeeded: bool
    message: str


class Destination(NamedTuple):
    """Place that a robot is sent to.

    Attributes:
        course: Course of the world.
        goal: Goal (x, y, yaw) as it was sent, in the frame of the plan.
        tolerance: Distance from the goal within which the planner counts it as reached [m].
    """

    course: Course
    goal: Pose
    tolerance: float

    def end(
        self, pose: Pose, left: float, result: Optional[PlannerResult], is_close: bool = False
    ) -> Optional[CourseEnd]:
        """Return how a course ends by arrival or by the planner, or None if it goes on.

        A course ends at its finish (Course.arrived). The robot may stop short of the course's goal
        by the planner's tolerance if the planner reports success, or if it `is_close`. After a
        result away from the goal, the robot would stand until the time limit. The course therefore
        ends at once.

        Args:
            pose: True pose (x, y, yaw) of the robot.
            left: Distance from the sent goal by the odometry [m].
            result: Result of the planner's goal, None while it drives.
            is_close: Whether the place within the planner's tolerance is enough.
        """
        x, y, _ = pose
        has_succeeded = result is not None and result.has_succeeded
        with_tolerance = is_close or has_succeeded
        if self.course.arrived(x, y, self.tolerance if with_tolerance else None):
            return CourseEnd(REACHED, "finished")
        if result is None:
            return None
        reason = ended_early(
            has_succeeded=has_succeeded,
            text=result.message,
            left_by_odometry=left,
            left_in_truth=math.dist(pose[:2], self.course.sent_goal[:2]),
            tolerance=self.tolerance,
        )
        return CourseEnd(ABORTED, reason)


@dataclass(frozen=True)
class Rules:
    """Rules that end a course, besides arrival, a robot that lies on its side, and the planner.

    Attributes:
        end_on_contact: Whether a contact ends the course, as under the BARN Challenge's protocol.
        end_on_stall: Whether a stall (policy/stuck.py) ends the course as a failure.
        ends_at_tolerance: Whether the course ends as soon as the robot is within the planner's goal
            tolerance, or only when the planner reports its goal as reached, after it has also
            turned to the goal's heading.
        limit: Time after which the course counts as failed [s]. It is rounded to whole decision
            periods, of which there is at least one.
    """

    end_on_contact: bool = False
    end_on_stall: bool = False
    ends_at_tolerance: bool = True
    limit: float = TIME_LIMIT

    def periods(self, period: float) -> int:
        """Return the number of decision periods [s] after which a course times out."""
        return max(1, round(self.limit / period))

    def judge(self, tick: Tick, destination: Destination) -> Optional[CourseEnd]:
        """Return how the course ends with a control cycle, or None if it goes on.

        The planner has reached the goal if it reports success, or with `ends_at_tolerance` if the
        robot's place is within the tolerance although the robot has still to stop and turn. If the
        goal is occupied (default_tolerance), only the report counts.
        """
        distance = math.dist(tick.place[:2], destination.goal[:2])
        is_close = self.ends_at_tolerance and distance <= destination.tolerance
        result = None
        if tick.step.cycle.result is not None:
            status, message = tick.step.cycle.result
            result = PlannerResult(status == "succeeded", message)
        end = destination.end(tick.after.pose, distance, result, is_close)
        if end is not None and end.status == REACHED:
            return end
        if tick.after.flipped:
            return CourseEnd(FLIPPED, "flipped")
        if self.end_on_contact and tick.after.contact:
            return CourseEnd(TOUCHED, "contact")
        return end

    def judge_period(
        self, period: float, period_count: int, has_stalled: bool
    ) -> Optional[CourseEnd]:
        """Return how the course ends with a decision period, or None if it goes on.

        Args:
            period: Decision period [s].
            period_count: Number of periods since the goal was sent.
            has_stalled: Whether the robot makes no progress.
        """
        if has_stalled and self.end_on_stall:
            return CourseEnd(STALLED, "stalled")
        if period_count >= self.periods(period):
            return CourseEnd(TIMED_OUT, "time limit")
        return None
