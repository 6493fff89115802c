"""Opens ROS 1 bags without an index, as they are where a recording was cut short: by the chunks that are whole."""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from io import BytesIO
from typing import Any, Dict, List

from rosbags.interfaces import Connection
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag1.reader import Header, RecordType, read_uint32


def open_cut(reader: rosbag1.Reader) -> None:
    """Does for such a bag what Reader.open does. Raises ReaderError where no chunk is whole."""
    known: Dict[int, Connection] = {}
    indexes: Dict[int, List[rosbag1.IndexData]] = defaultdict(list)
    file: Any = reader.path.open("rb")
    reader.bio = file
    file.readline()
    with suppress(Exception):  # at the first record that is not whole
        while True:
            place, kind = file.tell(), Header.read(file).get_uint8("op")
            if kind != RecordType.CHUNK:
                file.seek(read_uint32(file), os.SEEK_CUR)
                continue
            file.seek(place)
            chunk = reader.read_chunk()
            file.seek(chunk.datapos)
            data = chunk.decompressor(rosbag1.read_bytes(file, chunk.datasize))
            reader.chunks[place], reader.bio = chunk, BytesIO(data)
            _index(reader, place, len(data), known, indexes)
            reader.bio = file
    reader.bio = file
    reader.indexes = {number: sorted(indexes[number]) for number in known}
    reader.connections = [one._replace(msgcount=len(reader.indexes[number])) for number, one in known.items()]
    times = [entry.time for entries in reader.indexes.values() for entry in entries]
    if not times:
        reader.close()
        raise rosbag1.ReaderError("no chunk of it is whole")
    counts = {one.id: one.msgcount for one in reader.connections}
    reader.chunk_infos = [rosbag1.ChunkInfo(0, min(times), max(times) + 1, counts)]


def _index(reader: rosbag1.Reader, place: int, size: int, known: Dict[int, Connection], indexes) -> None:
    """Notes the connections and messages of the chunk that begins at a place of the file; reader.bio holds its data."""
    data: Any = reader.bio
    while data.tell() < size:
        offset = data.tell()
        header = Header.read(data)
        if header.get_uint8("op") == RecordType.MSGDATA:
            entry = rosbag1.IndexData(header.get_time("time"), place, offset)
            data.seek(read_uint32(data), os.SEEK_CUR)
            indexes[header.get_uint32("conn")].append(entry)
        else:
            data.seek(offset)
            connection = reader.read_connection()
            known.setdefault(connection.id, connection)
