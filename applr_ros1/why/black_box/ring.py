"""Memory of the last minutes: serialised messages of the topics that an answer needs."""

from __future__ import annotations

import struct
import threading
import zlib
from collections import deque
from itertools import chain
from typing import Deque, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import SECOND
from applr_ros1.why.black_box.bag_file import Publication, RawMessage

LARGEST_SHARE = 0.1  # largest share of the memory that one message may take
MESSAGE_BYTES = 200  # memory that a message takes beside its data: objects of Python [bytes]
BLOCK_BYTES = 256_000  # size from which on messages are compressed, half a second of a Jackal's
COMPRESSION = 1  # level of zlib: higher ones gain little, and take several times as long
# Message in a block: time [ns], number of its publication, whether it holds, length of its data
PACKED_HEADER = struct.Struct("<qH?I")
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


class PackedBlock:
    """Successive messages, compressed.

    Plans, transforms and scans are much like the ones before: a Jackal's take a fifth of their size
    (measured with the bags of docs/results/replayed.csv), for .3 % of a core.

    Args:
        kept_messages: The messages, at least one.

    Attributes:
        first_time: Time of the first message [ns].
        last_time: Time of the last message [ns].
        holding: Last message of each publication whose messages hold until the next one.
        byte_count: Memory that the block takes [bytes].
    """

    def __init__(self, kept_messages: Sequence[KeptMessage]):
        self.first_time = kept_messages[0].message.time
        self.last_time = kept_messages[-1].message.time
        self.holding: Dict[Publication, RawMessage] = {}
        numbers: Dict[Publication, int] = {}
        parts = []
        for message, holds in kept_messages:
            number = numbers.setdefault(message.publication, len(numbers))
            parts.append(PACKED_HEADER.pack(message.time, number, holds, len(message.data)))
            parts.append(message.data)
            if holds:
                self.holding[message.publication] = message
        self._publications = list(numbers)
        self._packed = zlib.compress(b"".join(parts), COMPRESSION)
        self.byte_count = len(self._packed) + sum(map(size_of, self.holding.values()))

    def __iter__(self) -> Iterator[KeptMessage]:
        """Yield the messages."""
        content = zlib.decompress(self._packed)
        position = 0
        while position < len(content):
            time, number, holds, length = PACKED_HEADER.unpack_from(content, position)
            position += PACKED_HEADER.size
            data = content[position : position + length]
            position += length
            yield KeptMessage(RawMessage(time, self._publications[number], data), holds)


class Ring:
    """The latest messages, bounded in time and memory.

    All but the latest ones are compressed in blocks, and leave with their block. Of a publication
    whose messages hold until the next one (a plan, a parameter), the last message that left the
    ring is kept: it still holds when the ring begins. All methods may be called from several
    threads.

    Args:
        seconds: Time that is kept [s].
        most_bytes: Largest memory [bytes], with the messages that still hold; the oldest messages
            leave first.

    Attributes:
        byte_count: Memory that the messages take [bytes].
    """

    def __init__(self, seconds: float, most_bytes: int):
        self._span = round(seconds * SECOND)
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._blocks: Deque[PackedBlock] = deque()
        self._latest: Deque[KeptMessage] = deque()  # messages after the blocks
        self._latest_bytes = 0  # memory of the latest messages [bytes]
        self._held: Dict[Publication, RawMessage] = {}
        self.byte_count = 0
        self._last_time = 0  # time of the latest message [ns]

    @property
    def seconds(self) -> float:
        """Time that is kept so far [s]."""
        with self._lock:
            first_time = self._last_time
            if self._blocks:
                first_time = self._blocks[0].first_time
            elif self._latest:
                first_time = self._latest[0].message.time
            span = min(self._last_time - first_time, self._span)
        return span / SECOND

    def add(self, message: RawMessage, holds: bool = False) -> None:
        """Add a message that came now.

        Args:
            message: The message.
            holds: Whether it holds until the next one of its publication.

        Raises:
            ApplrError: It is larger than a tenth of the memory, and left out.
        """
        largest_bytes = LARGEST_SHARE * self._most_bytes
        if size_of(message) > largest_bytes:
            problem = f"a message of {size_of(message) / 1e6:.1f} MB is left out"
            raise ApplrError(f"{problem}: send at most {largest_bytes / 1e6:.1f} MB")
        with self._lock:
            # A message whose thread had to wait comes after later ones of other threads.
            self._last_time = max(message.time, self._last_time)
            self._latest.append(KeptMessage(message, holds))
            self._latest_bytes += size_of(message)
            self.byte_count += size_of(message)
            if self._latest_bytes >= BLOCK_BYTES:
                self._pack()
            earliest = self._last_time - self._span
            while self.byte_count > self._most_bytes or self._is_oldest_before(earliest):
                self._drop_oldest()

    def _pack(self) -> None:
        """Compress the latest messages."""
        block = PackedBlock(list(self._latest))
        self._blocks.append(block)
        self.byte_count += block.byte_count - self._latest_bytes
        self._latest.clear()
        self._latest_bytes = 0

    def _is_oldest_before(self, earliest: int) -> bool:
        """Return whether the oldest block, or else message, lies before a time [ns]."""
        if self._blocks:
            return self._blocks[0].last_time < earliest
        return bool(self._latest) and self._latest[0].message.time < earliest

    def _drop_oldest(self) -> None:
        """Drop the oldest block, or else the oldest message, or else what holds."""
        if self._blocks:
            block = self._blocks.popleft()
            self.byte_count -= block.byte_count
            self._hold(block.holding)
        elif self._latest:
            message, holds = self._latest.popleft()
            self._latest_bytes -= size_of(message)
            self.byte_count -= size_of(message)
            if holds:
                self._hold({message.publication: message})
        else:
            self._held.clear()
            self.byte_count = 0

    def _hold(self, holding: Mapping[Publication, RawMessage]) -> None:
        """Keep messages that leave the ring, in place of those that held before."""
        for publication, message in holding.items():
            replaced_message = self._held.get(publication)
            if replaced_message is not None:
                self.byte_count -= size_of(replaced_message)
            self._held[publication] = message
            self.byte_count += size_of(message)

    def start_anew(self) -> None:
        """Drop all messages except for those that hold.

        Times before a jump of the clock cannot be compared with those after it.
        """
        with self._lock:
            while self._blocks or self._latest:
                self._drop_oldest()
            self._last_time = 0

    def messages(self, begin: int = 0) -> Iterator[RawMessage]:
        """Return the messages that are kept now, since `begin` [ns], those first that hold then.

        A message that came before and still holds gets the time of the first one. Blocks are
        unpacked one by one, so that the messages need not fit into memory.
        """
        with self._lock:
            blocks = list(self._blocks)
            latest_messages = list(self._latest)
            holding = dict(self._held)
            earliest = max(begin, self._last_time - self._span)
        return _unpacked_since(earliest, blocks, latest_messages, holding)


def size_of(message: RawMessage) -> int:
    """Return the memory that a message takes [bytes]."""
    return len(message.data) + MESSAGE_BYTES


def _unpacked_since(
    begin: int,
    blocks: Sequence[PackedBlock],
    latest_messages: Sequence[KeptMessage],
    holding: Dict[Publication, RawMessage],
) -> Iterator[RawMessage]:
    """Yield messages since `begin` [ns], those first that hold then.

    Args:
        begin: Time of the first message [ns].
        blocks: Blocks in order of time.
        latest_messages: Messages after the blocks.
        holding: Messages from before the blocks that still hold.
    """
    parts: List[Iterable[KeptMessage]] = []
    for block in blocks:
        if block.last_time < begin:
            holding.update(block.holding)
        else:
            parts.append(block)
    parts.append(latest_messages)
    is_begun = False
    for message, holds in chain.from_iterable(parts):
        if message.time < begin:
            if holds:
                holding[message.publication] = message
            continue
        if not is_begun:
            is_begun = True
            for held_message in holding.values():
                yield held_message._replace(time=message.time)
        yield message
