"""Files of serialised messages in the format of rosbag (version 2.0), without ROS.

The messages stay as they came, and no definition of a message is compiled.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from typing import (
    BinaryIO,
    DefaultDict,
    Dict,
    Iterable,
    List,
    NamedTuple,
    Sequence,
    Tuple,
)

from applr_ros1.drives.columns import SECOND

MAGIC = b"#ROSBAG V2.0\n"
HEADER_BYTES = 4096  # length of the first record, which is padded to it
CHUNK_BYTES = 4_000_000  # length from which on a chunk is complete
# Kinds of records (http://wiki.ros.org/Bags/Format/2.0)
MESSAGE = b"\2"
FILE_HEADER = b"\3"
INDEX = b"\4"
CHUNK = b"\5"
CHUNK_INFO = b"\6"
CONNECTION = b"\7"
UINT32 = struct.Struct("<I")
UINT64 = struct.Struct("<Q")
TIME = struct.Struct("<II")  # seconds, nanoseconds
ENTRY = struct.Struct("<III")  # time of a message, and its offset in the chunk


class Publication(NamedTuple):
    """Topic of one publisher.

    Attributes:
        topic: Name of the topic.
        type: Type of the messages, such as nav_msgs/Path.
        md5sum: Checksum of the type's definition.
        definition: Definition of the type.
        publisher: Name of the node.
        is_latched: Whether new subscribers get the last message.
    """

    topic: str
    type: str
    md5sum: str
    definition: str = ""
    publisher: str = ""
    is_latched: bool = False


class RawMessage(NamedTuple):
    """Serialised message: when it came [ns], its topic, and its bytes."""

    time: int
    publication: Publication
    data: bytes


def write_messages(file: BinaryIO, messages: Iterable[RawMessage]) -> None:
    """Write messages in order of time as a bag to a file at its begin."""
    connections: Dict[Publication, int] = {}
    chunk_infos: List[bytes] = []
    position = file.write(MAGIC)
    position += file.write(_file_header(0, 0, 0))
    chunk = _Chunk(position)
    for message in messages:
        number = connections.get(message.publication)
        if number is None:
            number = connections[message.publication] = len(connections)
            chunk.add_connection(number, message.publication)
        chunk.add_message(number, message)
        if chunk.length >= CHUNK_BYTES:
            chunk_infos.append(chunk.written_to(file))
            chunk = _Chunk(chunk.end)
    if chunk.length:
        chunk_infos.append(chunk.written_to(file))

    # Connections and chunks once more at the end, where readers look for them
    for publication, number in connections.items():
        file.write(_connection(number, publication))
    for chunk_info in chunk_infos:
        file.write(chunk_info)
    # Only now it is known where the index is.
    file.seek(len(MAGIC))
    file.write(_file_header(chunk.end, len(connections), len(chunk_infos)))


class _Chunk:
    """Part of a bag with some messages and the connections that are new in it.

    Args:
        position: Its position in the bag [bytes].

    Attributes:
        length: Number of bytes so far.
        end: Position after what is written of it [bytes].
    """

    def __init__(self, position: int) -> None:
        self.length = 0
        self.end = position
        self._parts: List[bytes] = []
        self._entries: DefaultDict[int, List[bytes]] = defaultdict(list)
        self._times: List[int] = []

    def add_connection(self, number: int, publication: Publication) -> None:
        """Add the description of a topic."""
        self._add(_connection(number, publication))

    def add_message(self, number: int, message: RawMessage) -> None:
        """Add a message of the topic with a number."""
        seconds, nanoseconds = divmod(message.time, SECOND)
        self._entries[number].append(ENTRY.pack(seconds, nanoseconds, self.length))
        self._times.append(message.time)
        fields = [
            (b"op", MESSAGE),
            (b"conn", UINT32.pack(number)),
            (b"time", TIME.pack(seconds, nanoseconds)),
        ]
        self._add(_record(fields, message.data))

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self.length += len(part)

    def written_to(self, file: BinaryIO) -> bytes:
        """Write the chunk with its index, and return the record that describes it."""
        position = self.end
        fields = [
            (b"op", CHUNK),
            (b"compression", b"none"),
            (b"size", UINT32.pack(self.length)),
        ]
        self.end += file.write(_record_head(fields, self.length))
        # Without a copy of the whole chunk
        for part in self._parts:
            self.end += file.write(part)
        counts = []
        for number, entries in self._entries.items():
            fields = [
                (b"op", INDEX),
                (b"ver", UINT32.pack(1)),
                (b"conn", UINT32.pack(number)),
                (b"count", UINT32.pack(len(entries))),
            ]
            self.end += file.write(_record(fields, b"".join(entries)))
            counts.append(UINT32.pack(number) + UINT32.pack(len(entries)))
        fields = [
            (b"op", CHUNK_INFO),
            (b"ver", UINT32.pack(1)),
            (b"chunk_pos", UINT64.pack(position)),
            (b"start_time", TIME.pack(*divmod(min(self._times), SECOND))),
            (b"end_time", TIME.pack(*divmod(max(self._times), SECOND))),
            (b"count", UINT32.pack(len(counts))),
        ]
        return _record(fields, b"".join(counts))


def _file_header(index_position: int, connection_count: int, chunk_count: int) -> bytes:
    fields = [
        (b"op", FILE_HEADER),
        (b"index_pos", UINT64.pack(index_position)),
        (b"conn_count", UINT32.pack(connection_count)),
        (b"chunk_count", UINT32.pack(chunk_count)),
    ]
    empty_length = len(_record(fields, b""))
    return _record(fields, b" " * (HEADER_BYTES - empty_length))


def _connection(number: int, publication: Publication) -> bytes:
    fields = [
        (b"op", CONNECTION),
        (b"conn", UINT32.pack(number)),
        (b"topic", publication.topic.encode()),
    ]
    description = [
        (b"topic", publication.topic.encode()),
        (b"type", publication.type.encode()),
        (b"md5sum", publication.md5sum.encode()),
        (b"message_definition", publication.definition.encode()),
        (b"callerid", publication.publisher.encode()),
        (b"latching", b"1" if publication.is_latched else b"0"),
    ]
    return _record(fields, _packed(description))


def _packed(fields: Sequence[Tuple[bytes, bytes]]) -> bytes:
    """Return named fields, each with its length in front."""
    parts = []
    for name, value in fields:
        parts.append(UINT32.pack(len(name) + 1 + len(value)) + name + b"=" + value)
    return b"".join(parts)


def _record(fields: Sequence[Tuple[bytes, bytes]], data: bytes) -> bytes:
    return _record_head(fields, len(data)) + data


def _record_head(fields: Sequence[Tuple[bytes, bytes]], length: int) -> bytes:
    """Return the beginning of a record, before data of a length."""
    header = _packed(fields)
    return UINT32.pack(len(header)) + header + UINT32.pack(length)
