"""Files written whole or not at all, and one line when they cannot be. Used by everything in training/ that writes."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from pathlib import Path
from typing import Any


class StorageError(OSError):
    """A file or folder that cannot be read or written; one line with what, why and the remedy."""

    def __str__(self):
        return str(self.args[0])


def write_bytes(path, data: bytes) -> None:
    """Write beside, flush to disk, rename: a crash leaves the old file or the new one, never a part."""
    path = Path(path)
    partial = path.with_name("%s.%d.partial" % (path.name, os.getpid()))
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        try:  # noqa: SIM105
            partial.unlink()
        except OSError:
            pass
        raise StorageError(
            "%s: cannot be written (%s); the file that was there is untouched" % (path, reason(error))
        ) from None


def write_json(path, value: Any) -> None:
    """Write a value as JSON, in one step (see write_bytes)."""
    write_bytes(path, (json.dumps(value, indent=1) + "\n").encode())


def read_bytes(path) -> bytes:
    """The content of a file. Raises StorageError with one line if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise StorageError("%s: cannot be read (%s)" % (path, reason(error))) from None


def read_json(path) -> Any:
    """The content of a JSON file. Raises StorageError with one line if it is absent or damaged."""
    try:
        return json.loads(read_bytes(path))
    except (ValueError, RecursionError):
        raise StorageError("%s: not JSON; the file is damaged" % path) from None


def sha256(data: bytes) -> str:
    """The SHA-256 digest in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def reason(error: OSError) -> str:
    """What the system says of a failed file operation."""
    return error.strerror or str(error)


def make_folder(path) -> Path:
    """The folder, made if need be, and writable."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError("%s: cannot be made (%s); give another --out" % (path, reason(error))) from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise StorageError("%s: is not writable; give another --out" % path)
    return path


class Lock:
    """One process per run folder. The system lets go of it when the process ends, however it ends."""

    def __init__(self, folder, who: str = "train.py"):
        try:
            self._file = open(Path(folder) / "lock", "w")  # noqa: SIM115
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StorageError(
                "%s: another %s works in this folder; wait, or give another --out" % (folder, who)
            ) from None
        except OSError as error:
            raise StorageError("%s: cannot be locked (%s)" % (folder, reason(error))) from None

    def release(self) -> None:
        """Let another process use the folder."""
        self._file.close()
