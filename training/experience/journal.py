"""The replay on disk: every trajectory that the learner took, in order, appended the moment it is taken.

A checkpoint is the networks plus a place in this journal, so that it costs little however large the replay is; and what
came after the checkpoint is not lost when the process is killed, because the learner goes through it again. learner.py
writes and reads it. A segment file is a row of records: "APTR", length, CRC-32, payload; the first is a JSON header.
"""

from __future__ import annotations

import io
import json
import logging
import os
import re
import struct
import zlib
from pathlib import Path
from typing import BinaryIO, Dict, Iterator, List, Optional, Set, Tuple

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError
from training.storage import make_folder

MAGIC, FORMAT = b"APTR", "applr-journal-1"
_FRAME = struct.Struct("<4sII")
LARGEST = 1 << 28

log = logging.getLogger(__name__)


class Journal:
    """A folder of segments. A torn last record, in flight when the process died, is left out.

    Opening it changes nothing on the disk: the first append() makes the folder, or drops what is torn. Of a segment
    that is damaged in its middle, what is before that is read, and one line says how much is not; nothing is deleted,
    and the next record begins another segment.

    Raises:
        StorageError: with one line, where a segment does not begin with a header, so that none of it can be read.
    """

    def __init__(self, folder, segment_bytes: int = 1 << 26):
        self.folder, self.segment_bytes = Path(folder), segment_bytes
        self.segments: List[int] = sorted(int(p.stem) for p in self.folder.glob("*.segment") if p.stem.isdigit())
        self._begun: List[int] = []  # segments too short for a record, in flight when the process died
        for path in map(self._path, self.segments):
            if not path.is_file():  # opening a pipe would wait for ever
                raise StorageError("%s: a folder, pipe or device; a journal's segments are regular files" % path)
        self._damaged: Set[int] = set()  # segments that hold more than can be read, each said once
        self._file: Optional[int] = None  # of the last segment, while it is open
        self.offset = 0
        while self.segments and self._is_begun(self._path(self.segments[-1])):
            self._begun.append(self.segments.pop())
        for segment in self.segments:
            self._header(segment)
        if self.segments:
            self.offset = self._good_length(self.segments[-1])  # what is behind it goes with the next record

    # -- writing -----------------------------------------------------------------------------------
    def append(self, blob: bytes, header: Dict) -> None:
        """Add a record. `header` goes first into a new segment, should one be begun."""
        while self._begun:
            self._path(self._begun.pop()).unlink(missing_ok=True)
        if self._file is None and self.segments and self.segments[-1] not in self._damaged:
            os.ftruncate(self._open(self.segments[-1]), self.offset)
        if self._file is None or self.offset > self.segment_bytes:
            self._begin(header)
        self._write(blob)

    def sync(self) -> None:
        """Wait until everything that was appended is on the disk."""
        if self._file is not None:
            os.fsync(self._file)

    @property
    def place(self) -> List[int]:
        """[segment, offset] behind the last record."""
        return [self.segments[-1] if self.segments else 0, self.offset]

    def forget_before(self, rows: int) -> None:
        """Delete segments all of whose rows come before `rows` (the ring has overwritten them)."""
        while len(self.segments) > 1 and self._header(self.segments[1])["rows"] <= rows:
            self._path(self.segments.pop(0)).unlink(missing_ok=True)

    def close(self) -> None:
        """Close the current segment."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    # -- reading -----------------------------------------------------------------------------------
    def header(self) -> Optional[Dict]:
        """The header of the first segment; None for an empty journal."""
        return self._header(self.segments[0]) if self.segments else None

    def _header(self, segment: int) -> Dict:
        for _, blob in self._records(segment):
            try:
                header = json.loads(blob)
            except ValueError:
                header = {}
            if isinstance(header, dict) and header.get("format") == FORMAT:
                return header
            break
        raise StorageError(
            "%s: its beginning is damaged or missing; put a copy of the file there, or move it away to export the "
            "others" % self._path(segment)
        )

    def read(self, since=None, until=None) -> Iterator[bytes]:
        """Records from place `since` (all) up to place `until` (the end)."""
        if until is not None and tuple(until) > tuple(self.place):
            raise StorageError(
                "%s: ends at %s, the checkpoint needs it up to %s; files are missing or damaged"
                % (self.folder, self.place, list(until))
            )
        for segment in list(self.segments):
            if since is not None and segment < since[0]:
                continue
            begin = since[1] if since is not None and segment == since[0] else 0
            for i, (end, blob) in enumerate(self._records(segment, begin)):
                if until is not None and (segment, end) > tuple(until):
                    return
                if begin or i:  # the first record of a segment is its header
                    yield blob

    # -- segments ----------------------------------------------------------------------------------
    def _path(self, segment: int) -> Path:
        return self.folder / ("%06d.segment" % segment)

    def _open(self, segment: int) -> int:
        try:
            self._file = os.open(self._path(segment), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self._path(segment), reason(error))) from None
        return self._file

    def _begin(self, header: Dict) -> None:
        self.sync()
        self.close()
        segment = self.segments[-1] + 1 if self.segments else 0
        make_folder(self.folder)
        self._open(segment)
        self.segments.append(segment)
        self.offset = 0
        self._write(json.dumps(dict(header, format=FORMAT)).encode())

    def _write(self, blob: bytes) -> None:
        assert self._file is not None
        data = _FRAME.pack(MAGIC, len(blob), zlib.crc32(blob)) + blob
        try:
            view = memoryview(data)
            while view:
                view = view[os.write(self._file, view) :]
        except OSError as error:
            os.ftruncate(self._file, self.offset)  # take the part back: the journal stays whole
            raise StorageError(
                "%s: cannot be written (%s); free some space and --resume; the last checkpoint is intact"
                % (self._path(self.segments[-1]), reason(error))
            ) from None
        self.offset += len(data)

    def _records(self, segment: int, begin: int = 0) -> Iterator[Tuple[int, bytes]]:
        """(offset behind it, payload) of each whole record; stops at the first that is not."""
        path = self._path(segment)
        try:
            with open(path, "rb") as file:
                size = os.fstat(file.fileno()).st_size  # a run that goes on may append meanwhile
                offset = file.seek(begin)
                while (blob := _payload(file)) is not None:
                    offset += _FRAME.size + len(blob)
                    yield offset, blob
                file.seek(offset)
                self._see_rest(segment, offset, file.read(max(0, size - offset)))
        except OSError as error:
            raise StorageError("%s: cannot be read (%s)" % (path, reason(error))) from None

    def _see_rest(self, segment: int, offset: int, rest: bytes) -> None:
        """Says what a segment holds behind the last record that can be read, once, but for a torn last record.

        A segment whose very first record cannot be read is an error of its own.
        """
        if not rest or not offset or segment in self._damaged:
            return
        if segment == self.segments[-1] and _is_torn(rest):
            return
        self._damaged.add(segment)
        log.warning(
            "%s: damaged at byte %d: the %d bytes from there on are not read; a copy of the file put there brings them "
            "back",
            self._path(segment),
            offset,
            len(rest),
        )

    @staticmethod
    def _is_begun(path: Path) -> bool:
        """Whether a segment ends within its first record."""
        with open(path, "rb") as file:
            if _payload(file) is not None:
                return False
            file.seek(0)
            rest = file.read()
        return len(rest) < _FRAME.size or _is_torn(rest)

    def _good_length(self, segment: int) -> int:
        return max((end for end, _ in self._records(segment)), default=0)


def _payload(file: BinaryIO) -> Optional[bytes]:
    """The payload of the record that begins here; None where there is no whole one."""
    frame = file.read(_FRAME.size)
    if len(frame) < _FRAME.size:
        return None
    magic, length, crc = _FRAME.unpack(frame)
    if magic != MAGIC or length > LARGEST:
        return None
    blob = file.read(length)
    return blob if len(blob) == length and zlib.crc32(blob) == crc else None


def _is_torn(rest: bytes) -> bool:
    """Whether these bytes are the beginning of one record and nothing else: no whole record is among them."""
    if len(rest) >= _FRAME.size:
        length = _FRAME.unpack(rest[: _FRAME.size])[1]
        if length > LARGEST or _FRAME.size + length <= len(rest):
            return False
    file = io.BytesIO(rest)
    for found in re.finditer(MAGIC, rest):
        file.seek(found.start())
        if _payload(file) is not None:
            return False
    return rest[: len(MAGIC)] == MAGIC[: len(rest)]
