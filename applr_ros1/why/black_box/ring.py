"""Memory of the last minutes: serialised messages of the topics that an answer needs."""

from __future__ import annotations

import threading
from collections import deque
from typing import Deque, Dict, List, NamedTuple

from applr_ros1.drives.columns import SECOND
from applr_ros1.why.black_box.bag_file import Publication, RawMessage

JUMP_NS = SECOND // 2  # step back of the time of messages from which on the clock was set back [ns]
MESSAGE_BYTES = 200  # memory that a message takes beside its data: objects of Python [bytes]
# Columns whose messages hold until the next one
HOLDING = ("static_transforms", "changes", "routes", "sent", "verdicts")
ROUTES_NS = SECOND  # interval between plans of the global planner that are kept [ns]
# A path without poses is its header alone, whose frame has a short name; a pose has 72 bytes more.
EMPTY_BYTES = 85


class KeptMessage(NamedTuple):
    """Message in the ring, and whether it holds until the next one of its publication."""

    message: RawMessage
    holds: bool


class RouteFilter:
    """Leaves out plans of the global planner that no answer needs.

    Beside the plans that the local planner follows, only the goal at their ends and the times
    without a plan are read. They are half of all bytes of a robot that plans in every cycle.
    """

    def __init__(self) -> None:
        self._followed_until = 0  # time until which a followed plan counts as the latest [ns]
        self._next_route = 0  # time from which on the next plan is kept [ns]
        self._was_empty = True

    def keeps(self, key: str, message: RawMessage) -> bool:
        """Return whether a message of a topic of COLUMNS is kept."""
        # DWAPlannerROS publishes empty plans while it finds no command.
        if key == "plans" and len(message.data) >= EMPTY_BYTES:
            self._followed_until = message.time + ROUTES_NS
        if key != "routes":
            return True
        is_empty = len(message.data) < EMPTY_BYTES
        is_followed = message.time < self._followed_until
        is_repeated = is_empty == self._was_empty and message.time < self._next_route
        # After a jump of the clock, the times of before say nothing.
        is_earlier = message.time < self._next_route - ROUTES_NS
        if is_followed and is_repeated and not is_earlier:
            return False
        self._was_empty = is_empty
        self._next_route = message.time + ROUTES_NS
        return True


class Ring:
    """The latest messages, bounded in time and memory.

    Of a publication whose messages hold until the next one (a plan, a parameter), the last message
    that left the ring is kept: it still holds when the ring begins. All methods may be called from
    several threads.

    Args:
        seconds: Time that is kept [s].
        most_bytes: Largest memory [bytes]; the oldest messages leave first.
    """

    def __init__(self, seconds: float, most_bytes: int):
        self._seconds = seconds
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._kept: Deque[KeptMessage] = deque()
        self._held: Dict[Publication, RawMessage] = {}
        self._byte_count = 0

    @property
    def byte_count(self) -> int:
        """Memory that the messages take [bytes]."""
        return self._byte_count

    @property
    def seconds(self) -> float:
        """Time between the first and the last message [s]."""
        with self._lock:
            if not self._kept:
                return 0.0
            span = self._kept[-1].message.time - self._kept[0].message.time
        return span / SECOND

    def add(self, message: RawMessage, holds: bool = False) -> None:
        """Add a message that came now.

        Args:
            message: The message.
            holds: Whether it holds until the next one of its publication.
        """
        with self._lock:
            # Times before a jump of the clock cannot be compared with those after it.
            if self._kept and message.time < self._kept[-1].message.time - JUMP_NS:
                self._drop_all()
            self._kept.append(KeptMessage(message, holds))
            self._byte_count += len(message.data) + MESSAGE_BYTES
            earliest = message.time - self._seconds * SECOND
            while self._kept[0].message.time < earliest or self._byte_count > self._most_bytes:
                self._drop_first()
                if not self._kept:
                    break

    def _drop_first(self) -> None:
        message, holds = self._kept.popleft()
        self._byte_count -= len(message.data) + MESSAGE_BYTES
        if holds:
            self._held[message.publication] = message

    def _drop_all(self) -> None:
        while self._kept:
            self._drop_first()

    def messages(self, begin: int = 0) -> List[RawMessage]:
        """Return the messages since `begin` [ns], those first that hold then.

        A message that came before and still holds gets the time of the first one.
        """
        with self._lock:
            kept = list(self._kept)
            holding = dict(self._held)
        latest_messages = []
        for message, holds in kept:
            if message.time >= begin:
                latest_messages.append(message)
            elif holds:
                holding[message.publication] = message
        if not latest_messages:
            return []
        first_time = latest_messages[0].time
        messages_before = [message._replace(time=first_time) for message in holding.values()]
        return messages_before + latest_messages
