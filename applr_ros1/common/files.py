"""Files are written whole or not at all and read with a bound; what goes wrong is a StorageError of one line."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from typing import Any

from applr_ros1.common.errors import ApplrError, reason

MAX_BYTES = 2**31  # of a file that is read where the caller knows no smaller bound
MAX_JSON = 2**28


class StorageError(ApplrError):
    """A file or folder that cannot be read or written."""


def write_bytes(path, data: bytes) -> None:
    """Writes beside the file, flushes to disk, renames: a crash leaves the old file or the new one, never a part."""
    path = os.fspath(path)
    if os.path.lexists(path) and not os.path.isfile(path):  # renaming over a device would remove it
        raise StorageError("%s: a folder, pipe or device; give the path of a regular file" % path)
    partial = "%s.%d.partial" % (path, os.getpid())
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except (OSError, ValueError) as problem:
        if os.path.exists(partial):
            os.unlink(partial)
        raise StorageError(
            "%s: cannot be written (%s); the file that was there is untouched" % (path, reason(problem))
        ) from None


def write_json(path, value: Any) -> None:
    """Writes a value as JSON that a person can read, as `write_bytes` does."""
    write_bytes(path, (json.dumps(value, indent=1) + "\n").encode())


def read_bytes(path, limit: int = MAX_BYTES) -> bytes:
    """The content of a regular file of at most `limit` bytes. Pipes, devices and folders are refused at once."""
    path = os.fspath(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise StorageError("%s: a folder, pipe or device; give a regular file" % path)
            with open(descriptor, "rb", closefd=False) as file:  # sizes in /proc read as 0
                data = file.read(min(limit, max(found.st_size, 2**16)) + 1)
        finally:
            os.close(descriptor)
    except StorageError:
        raise
    except (OSError, ValueError) as problem:  # ValueError: a NUL in the path
        raise StorageError("%s: cannot be read (%s); give an existing file" % (path, reason(problem))) from None
    if len(data) > limit:
        raise StorageError("%s: more than %d bytes are too many; give another file" % (path, limit))
    return data


def read_json(path, limit: int = MAX_JSON) -> Any:
    """The value in a JSON file."""
    data = read_bytes(path, limit)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as problem:
        raise StorageError(
            "%s: not JSON (%s); the file is damaged or of another kind" % (path, reason(problem))
        ) from None


def sha256(data: bytes) -> str:
    """The checksum of some bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()
