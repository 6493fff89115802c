"""The folder of a run: made where it is missing, and one process at a time in it."""

from __future__ import annotations

import fcntl
from pathlib import Path

from applr_ros1.common.files import StorageError


def make_folder(path) -> Path:
    """Make the folder with its parents if it is missing, and return it."""
    Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


class Lock:
    """One process per run folder. The system lets go of it when the process ends, however it ends.

    Args:
        folder: to lock, by the file "lock" in it.
        who: works in it, for people.
    """

    def __init__(self, folder, who: str = "train.py"):
        self._file = open(Path(folder) / "lock", "w")  # noqa: SIM115
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StorageError(f"{folder}: another {who} works in this folder; wait, or give another --out") from None

    def close(self) -> None:
        """Let another process use the folder."""
        self._file.close()
