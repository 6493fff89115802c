"""Memory of the last minutes: serialised messages of the topics that an answer needs."""

from __future__ import annotations

import threading
from collections import deque
from typing import Deque, Dict, List, NamedTuple

from applr_ros1.drives.columns import SECOND
from applr_ros1.why.black_box.bag_file import Publication, RawMessage

JUMP_NS = SECOND // 2  # step back of the time of messages from which on the clock was set back [ns]
MESSAGE_BYTES = 200  # memory that a message takes beside its data: objects of Python [bytes]


class Kept(NamedTuple):
    """Message in the ring, and whether it holds until the next one of its publication."""

    message: RawMessage
    holds: bool


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
        self._kept: Deque[Kept] = deque()
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
            self._kept.append(Kept(message, holds))
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
