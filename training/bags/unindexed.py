"""ROS 1 bags without an index, as they are where a recording was cut short: their whole chunks."""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from io import BytesIO
from typing import Any, Dict, List

from rosbags.interfaces import Connection
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag1.reader import Header, RecordType, read_uint32


class UnindexedReader(rosbag1.Reader):
    """A reader of a bag's chunks up to the first record that is not whole."""

    def open(self) -> None:
        """Make the index that the bag lacks. Raises ReaderError where no chunk is whole."""
        known: Dict[int, Connection] = {}
        indexes: Dict[int, List[rosbag1.IndexData]] = defaultdict(list)
        file: Any = self.path.open("rb")
        self.bio = file
        file.readline()
        with suppress(Exception):  # at the first record that is not whole
            while True:
                place, kind = file.tell(), Header.read(file).get_uint8("op")
                if kind != RecordType.CHUNK:
                    file.seek(read_uint32(file), os.SEEK_CUR)
                    continue
                file.seek(place)
                chunk = self.read_chunk()
                file.seek(chunk.datapos)
                data = chunk.decompressor(rosbag1.read_bytes(file, chunk.datasize))
                self.chunks[place], self.bio = chunk, BytesIO(data)
                self._index(place, len(data), known, indexes)
                self.bio = file
        self.bio = file
        self.indexes = {number: sorted(indexes[number]) for number in known}
        self.connections = [one._replace(msgcount=len(self.indexes[number])) for number, one in known.items()]
        times = [entry.time for entries in self.indexes.values() for entry in entries]
        if not times:
            self.close()
            raise rosbag1.ReaderError("no chunk of it is whole")
        counts = {one.id: one.msgcount for one in self.connections}
        self.chunk_infos = [rosbag1.ChunkInfo(0, min(times), max(times) + 1, counts)]

    def _index(self, place: int, size: int, known: Dict[int, Connection], indexes) -> None:
        """Note the connections and messages of the chunk at a place of the file, whose data self.bio holds."""
        data: Any = self.bio
        while data.tell() < size:
            offset = data.tell()
            header = Header.read(data)
            if header.get_uint8("op") == RecordType.MSGDATA:
                entry = rosbag1.IndexData(header.get_time("time"), place, offset)
                data.seek(read_uint32(data), os.SEEK_CUR)
                indexes[header.get_uint32("conn")].append(entry)
            else:
                data.seek(offset)
                connection = self.read_connection()
                known.setdefault(connection.id, connection)
