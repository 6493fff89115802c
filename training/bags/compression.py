"""Bounds on what rosbags unpacks: of a few kilobytes, bz2, lz4 and zstd can make gigabytes in one deaf call.

rosbags has no bound. bound_rosbags() gives it decompressors that unpack piece by piece, so that Ctrl-C is heard, and
that stop at MAX_UNPACKED. reader.py calls it before it opens a bag.
"""

from __future__ import annotations

import bz2
from types import SimpleNamespace
from typing import Any, Callable, Optional

import lz4.frame
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from applr_ros1.common.errors import ApplrError

MAX_UNPACKED = 2**28  # bytes of one chunk (rosbag makes chunks of 768 kB) or one compressed message
MAX_FILE = 2**36  # bytes of a file of a ROS 2 bag that is compressed as a whole; it is unpacked into a temporary file
PIECE = 2**20

zstd = rosbag2.zstd


def unpack(make: Callable[[], Any], data: bytes) -> bytes:
    """What `data` unpacks to, one stream after the other.

    Args:
        make: Makes a decompressor of bz2's interface: decompress(data, max_length), eof, unused_data.
        data: The compressed bytes.

    Raises:
        ApplrError: It is more than MAX_UNPACKED bytes.
        EOFError: The data end in the middle of a stream.
    """
    parts, size = [], 0
    while data:
        decompressor = make()
        while not decompressor.eof:
            part = decompressor.decompress(data, PIECE)
            data = b""
            size += len(part)
            if size > MAX_UNPACKED:
                raise ApplrError(f"unpacks to more than {MAX_UNPACKED >> 20} MiB")
            parts.append(part)
            if not part and decompressor.needs_input:
                raise EOFError("compressed data end too early")
        data = decompressor.unused_data
    return b"".join(parts)


class BoundedFile(zstd.ZstdFile):
    """A zstd file, unpacked as it is read; raises ApplrError behind MAX_FILE bytes."""

    def read(self, size: Optional[int] = -1) -> bytes:
        """The next bytes, `size` at most."""
        data = super().read(size)
        if self.tell() > MAX_FILE:
            raise ApplrError(f"unpacks to more than {MAX_FILE >> 30} GiB")
        return data


def _unpack_zstd(data: bytes) -> bytes:
    return unpack(zstd.ZstdDecompressor, data)


def bound_rosbags() -> None:
    """Replaces rosbags' decompressors, all of them, by bounded ones."""
    rosbag1.decompressors["bz2"] = lambda data: unpack(bz2.BZ2Decompressor, data)
    rosbag1.decompressors["lz4"] = lambda data: unpack(lz4.frame.LZ4FrameDecompressor, data)
    storage_mcap.DECOMPRESSORS["lz4"] = lambda data, size: unpack(lz4.frame.LZ4FrameDecompressor, data)
    storage_mcap.DECOMPRESSORS["zstd"] = lambda data, size: _unpack_zstd(data)
    bounded: Any = SimpleNamespace(open=BoundedFile, decompress=_unpack_zstd)  # of whole files, and of messages
    rosbag2.zstd = bounded
