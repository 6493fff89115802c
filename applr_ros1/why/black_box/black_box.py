"""The black box without ROS: what it keeps, when it finds a stop, writes a bag, and asks why.

Messages come from the threads of their topics; `look` is called about once a second. Time is an
argument.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Callable, Dict, Iterator, List, Optional

from applr_ros1.common.errors import ApplrError, one_line, reason
from applr_ros1.drives.columns import SECOND
from applr_ros1.drives.received import Received, TopicSource
from applr_ros1.why.black_box.answer_process import AnswerProcess
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.description import (
    TOPIC,
    TYPE,
    DescribedRobot,
    text_of,
    with_stop,
)
from applr_ros1.why.black_box.folder import StopFolder
from applr_ros1.why.black_box.ring import HOLDING, Ring, RouteFilter
from applr_ros1.why.black_box.stops import StopDetector
from applr_ros1.why.events import SAVED, RobotStop

AFTER_S = 10.0  # time after a stop that its bag has, too [s]
JUMP_NS = SECOND // 2  # step back of the time of messages from which on the clock was set back [ns]
LEAD_S = 15.0  # time before a stop that its answer looks at [s]
STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
DESCRIPTION = Publication(TOPIC, TYPE, STRING_MD5, "string data\n", "/black_box", True)


@dataclass
class PendingBag:
    """Bag that is still to be written.

    Attributes:
        stop: Its stop.
        moment: Time of the stop for the bag's name.
        messages: Its messages, if the clock jumped back since; else they are in the ring.
    """

    stop: RobotStop
    moment: str
    messages: Optional[Iterator[RawMessage]] = None


@dataclass
class BoxOutput:
    """Output of a look at the messages.

    Attributes:
        answer: New answer to a stop, as JSON values.
        lines: Lines for the log.
        problems: Lines that report what was lost.
    """

    answer: Optional[Dict[str, Any]] = None
    lines: List[str] = field(default_factory=list)
    problems: List[str] = field(default_factory=list)


class BlackBox:
    """Keeps messages, finds stops, writes their bags, and asks for their answers.

    Args:
        driven: Robot that drives.
        ring: Memory of the messages.
        folder: Folder of the bags.
        process: Process that answers.
        moment: Returns the present time for the name of a bag.

    Attributes:
        stop_count: Number of stops so far.
        lost_count: Number of stops without a bag.
        problem: Line about the latest bag if it was lost, else "".
    """

    def __init__(
        self,
        driven: DescribedRobot,
        ring: Ring,
        folder: StopFolder,
        process: AnswerProcess,
        moment: Callable[[], str],
    ):
        self._ring = ring
        self._folder = folder
        self._process = process
        self._moment = moment
        self._text = text_of(driven)
        self._detector = StopDetector(driven.robot)
        # guards detector, ring, bags and the latest times
        self._lock = threading.Lock()
        self._routes = RouteFilter()
        self._asked: List[PendingBag] = []
        self._pending: List[PendingBag] = []
        self._clock_time = ""  # time of day at which the latest stop was found
        self._latest_times: Dict[Publication, int] = {}  # time of each one's latest message [ns]
        self.stop_count = 0
        self.lost_count = 0
        self.problem = ""

    def describe(self, driven: DescribedRobot) -> None:
        """Go on with a robot of other topics, or with other parameters after a new start."""
        with self._lock:
            self._text = text_of(driven)
            self._detector.describe(driven.robot)

    def take(
        self, message: RawMessage, source: TopicSource, unpacked: Callable[[], Received]
    ) -> None:
        """Take a message that came now.

        Args:
            message: The message.
            source: Its topic.
            unpacked: Returns it with its rows, which is asked only of the messages that are needed.

        Raises:
            ApplrError: It is too large to be kept.
        """
        with self._lock:
            # A publisher's messages come in their order, in a thread of their own. On a busy
            # computer it may wait behind others, so that theirs tell nothing of the clock.
            latest_time = self._latest_times.get(message.publication, 0)
            if message.time < latest_time - JUMP_NS:
                self._start_anew()
            self._latest_times[message.publication] = message.time
            if self._routes.keeps(source.key, message):
                self._ring.add(message, source.key in HOLDING)
            if self._detector.wants(source.key, message.time):
                self._detector.take(unpacked())

    def _start_anew(self) -> None:
        """Keep what the pending bags have so far, and forget the rest: the clock jumped back."""
        for bag in chain(self._pending, self._asked):
            if bag.messages is None:
                bag.messages = self._messages(bag.stop)
        self._latest_times.clear()
        self._ring.start_anew()
        self._detector.forget()

    def save(self, now: float) -> str:
        """Take a moment [s] as a stop, because somebody asks to. Return the time in its name.

        Until its bag is written, all who ask get this one.
        """
        with self._lock:
            for bag in chain(self._asked, self._pending):
                if bag.stop.kind == SAVED and bag.messages is None:
                    return bag.moment
            bag = PendingBag(self._detector.asked(now), self._moment())
            self._asked.append(bag)
        return bag.moment

    def look(self, now: float) -> BoxOutput:
        """Find a new stop, write the bags that are due, and return what there is to say.

        now: Present time by the robot's clock [s].
        """
        output = BoxOutput()
        for bag in self._new_bags(now, output):
            self.stop_count += 1
            self._ask(bag.stop, output)
        for bag in self._due_bags(now):
            self._write(bag, output)
        output.answer = self._process.answer()
        return output

    def end(self) -> None:
        """Write what is pending, and end the process that answers."""
        for bag in self._due_bags(math.inf):
            self._write(bag, BoxOutput())
        self._process.end()

    def _new_bags(self, now: float, output: BoxOutput) -> List[PendingBag]:
        """Return the bags of stops that are new. One that comes again at a place is a line."""
        with self._lock:
            new_bags = self._asked
            self._asked = []
            stop = self._detector.stop(now)
            if stop is not None and stop.number > 1:
                again = f"again, as at {self._clock_time} ({stop.number} times)"
                output.lines.append(f"{stop} {again}")
            elif stop is not None:
                bag = PendingBag(stop, self._moment())
                self._clock_time = bag.moment.rpartition("_")[2].replace("-", ":")
                new_bags.append(bag)
            self._pending += new_bags
        return new_bags

    def _due_bags(self, now: float) -> List[PendingBag]:
        """Take the pending bags that are complete."""
        due_bags: List[PendingBag] = []
        waiting_bags: List[PendingBag] = []
        with self._lock:
            for bag in self._pending:
                is_complete = bag.messages is not None or now >= bag.stop.end + AFTER_S
                if is_complete:
                    due_bags.append(bag)
                else:
                    waiting_bags.append(bag)
            self._pending = waiting_bags
        return due_bags

    def _ask(self, stop: RobotStop, output: BoxOutput) -> None:
        """Ask why the robot stopped."""
        output.lines.append(str(stop))
        begin = round((stop.begin - LEAD_S) * SECOND)
        try:
            is_dropped = self._process.ask(self._messages(stop, begin))
        except OSError as problem:
            output.problems.append(f"no answer: the process cannot start ({reason(problem)})")
            return
        if is_dropped:
            output.problems.append("the answer to the stop before is dropped for this one")

    def _write(self, bag: PendingBag, output: BoxOutput) -> None:
        """Write the bag of a stop."""
        messages = bag.messages
        if messages is None:
            messages = self._messages(bag.stop)
        first_message = next(messages, None)
        try:
            if first_message is None:
                raise ApplrError("no message came: start what publishes scans and odometry")
            path = self._folder.save(bag.moment, chain([first_message], messages))
        except Exception as problem:
            # Whatever a file or a message holds, the next stop may be written.
            self.lost_count += 1
            self.problem = f"the stop of {bag.moment} is lost: {one_line(problem)}"
            output.problems.append(self.problem)
            return
        self.problem = ""
        output.lines.append(f"wrote {path}")

    def _messages(self, stop: RobotStop, begin: int = 0) -> Iterator[RawMessage]:
        """Return the messages since `begin` [ns], the description of robot and stop first."""
        return _described(with_stop(self._text, stop), self._ring.messages(begin))


def _described(text: str, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
    """Yield the description of the robot, then the messages; nothing if there are none."""
    first_message = next(messages, None)
    if first_message is None:
        return
    data = text.encode()
    serialised = len(data).to_bytes(4, "little") + data
    yield RawMessage(first_message.time, DESCRIPTION, serialised)
    yield first_message
    yield from messages
