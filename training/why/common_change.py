"""The change that would help most: one change for the worst stops of a logbook.

It is driven in the worlds of these stops, and advised only if it gains over all of them and makes
none of them worse, with seeds that did not choose it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from time import monotonic
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from training.attempts.candidates import Candidate
from training.attempts.trials import (
    BETTER,
    Arrival,
    DrivenCourse,
    WholeDriveTrials,
    course_in,
    drive_recorded,
    try_out,
)
from training.why.bag_answer import answer_to
from training.why.driven import NOT_AS_FAR, arrival_from, comes_as_far, values_of_arrival
from training.why.logbook import Logbook
from training.why.logged_bag import LoggedBag, key_of_drive
from training.why.recorded import BagAnswerOptions, with_description
from training.why.remedies import CANDIDATES
from training.workers.calls import CallFailed, CallLost
from training.workers.pool import Pool

WORST = 8  # number of stops in whose worlds candidates are driven
SAVED_S = 20.0  # interval at which simulated drives are saved [s]


@dataclass(frozen=True)
class CommonChange:
    """Drives in the worlds of the worst stops, and the change that they advise.

    Attributes:
        bags: Bags of the worst stops, the worst first: each is a course.
        trials: Drives on all courses.
    """

    bags: List[LoggedBag]
    trials: WholeDriveTrials

    @property
    def gains(self) -> List[float]:
        """Time that the remedy saves on each course [s]; negative if it costs some."""
        remedy = self.trials.remedy
        if remedy is None:
            return []
        gains = []
        for number in range(len(self.bags)):
            driven = self.trials.on_course(number)
            assert driven.remedy is not None
            gains.append(driven.recorded.seconds - driven.remedy.seconds)
        return gains

    @property
    def helped(self) -> List[bool]:
        """For each course, True if the remedy takes a tenth less time there."""
        helped = []
        for number, gain in enumerate(self.gains):
            recorded_seconds = self.trials.on_course(number).recorded.seconds
            helped.append(gain >= (1.0 - BETTER) * recorded_seconds)
        return helped


def change_for(
    logbook: Logbook, options: BagAnswerOptions, pool: Pool, driven: Callable[[], Any]
) -> Optional[CommonChange]:
    """Return what was driven for a logbook; None if there is nothing to drive, or no world counts.

    Args:
        logbook: The logbook, which gets a note about each bag whose seen world does not count.
        options: Robot and topics of bags that do not describe them.
        pool: Workers that drive.
        driven: Called after each drive.
    """
    bags = worst_bags(logbook)
    if not bags:
        return None
    # Candidates are compared by the defaults of the planner, which the worst bag's robot has.
    robot = with_description(bags[0].path, options).robot
    courses = [KeptCourse(bag, robot, options, pool, driven) for bag in bags]
    try:
        recorded = drive_recorded([kept.course for kept in courses])
        usable: List[KeptCourse] = []
        for number, kept in enumerate(courses):
            if comes_as_far(recorded.on_course(number, len(courses)), kept.bag.answer):
                usable.append(kept)
            else:
                problem = f"simulated with the recorded values, the robot {NOT_AS_FAR}"
                logbook.notes.append(f"{kept.bag.path}: {problem}")
        if not usable:
            return None
        bags = [kept.bag for kept in usable]
        trials = try_out([kept.course for kept in usable], merged(bags))
    finally:
        # Also after Ctrl-C
        for kept in courses:
            kept.save()
    return CommonChange(bags, trials)


def worst_bags(logbook: Logbook) -> List[LoggedBag]:
    """Return the bags of the worst stops that a change of parameters may help, the worst first.

    They are of the robot that lost most time.
    """
    bags: List[LoggedBag] = []
    first_robot = next(iter(logbook.robots))
    for logged in logbook.stops:
        bag = logged.bag
        is_drivable = bool(bag.answer.candidates) and not logged.stop.is_outside
        if bag.answer.robot == first_robot and is_drivable and bag not in bags:
            bags.append(bag)
    return bags[:WORST]


def merged(bags: Sequence[LoggedBag]) -> List[Candidate]:
    """Return the candidates of all bags, those that many of them have first."""
    counts: Counter[Tuple[Any, ...]] = Counter()
    first_candidates: Dict[Tuple[Any, ...], Candidate] = {}
    for bag in bags:
        for stored in bag.answer.candidates:
            candidate = Candidate(*stored)
            counts[candidate.new_values] += 1
            first_candidates.setdefault(candidate.new_values, candidate)
    return [first_candidates[new_values] for new_values, _ in counts.most_common(CANDIDATES)]


class KeptCourse:
    """Course of a bag, whose drives are kept beside the bag and made once."""

    def __init__(
        self,
        bag: LoggedBag,
        robot: Robot,
        options: BagAnswerOptions,
        pool: Pool,
        driven: Callable[[], Any],
    ):
        self.course = DrivenCourse(robot, bag.answer.policy_decides, self._begin)
        self.bag = bag
        self._options = options
        self._pool = pool
        self._driven = driven
        self._is_changed = False
        self._saved_at = monotonic()

    def save(self) -> None:
        """Write the drives that were made since the last saving."""
        if self._is_changed:
            self.bag.save()
        self._is_changed = False
        self._saved_at = monotonic()

    def _begin(self, changes: Sequence[Change], seed: int, to_beat: float) -> Callable[[], Arrival]:
        key = key_of_drive(changes, seed, to_beat)
        drives = self.bag.answer.drives
        if key in drives:
            return lambda: arrival_from(drives[key])
        arrival_of = self._course_in_pool().begin(changes, seed, to_beat)

        def kept() -> Arrival:
            try:
                drives[key] = values_of_arrival(arrival_of())
            except CallLost:
                raise
            except CallFailed as refusal:
                if not changes:
                    problem = "the recorded values cannot be driven in simulation"
                    raise ApplrError(f"{self.bag.path}: {problem}: {refusal}") from None
                drives[key] = None
            self._is_changed = True
            if monotonic() - self._saved_at > SAVED_S:
                self.save()
            self._driven()
            return arrival_from(drives[key])

        return kept

    def _course_in_pool(self) -> DrivenCourse:
        """Return the course on which the workers drive. It is not kept, but made from the bag."""
        if self.bag.conditions is None:
            try:
                answered = self._pool.submit(answer_to, self.bag.path, self._options).result()
            except CallFailed as failure:
                raise ApplrError(f"{self.bag.path}: {failure}") from None
            self.bag.conditions = answered.conditions
        assert self.bag.conditions is not None
        return course_in(self.bag.conditions, self._pool)
