"""Run folders: their creation, and a lock for one process at a time."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from applr_ros1.common.errors import ApplrError, reason


def make_folder(path: os.PathLike[str] | str) -> Path:
    """Make the folder with its parents if it is missing, and return it.

    Raises:
        ApplrError: There is a file of this name, or the folder cannot be made.
    """
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise ApplrError(f"{folder}: a file, not a folder; give another folder with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"{folder}: this folder cannot be made ({reason(error)})"
        raise ApplrError(f"{problem}; give another folder with --out") from None
    return folder


class Lock:
    """Lock of a run folder for one process.

    The system releases it when the process ends, even if killed.

    Args:
        folder: Folder to lock, through the file "lock" in it.
        who: Name of the program, for the error message.

    Raises:
        ApplrError: Another process holds the lock.
    """

    def __init__(self, folder: os.PathLike[str] | str, who: str = "./applr train"):
        # Kept open: closing the file releases the lock.
        self._file = open(Path(folder) / "lock", "w")  # noqa: SIM115
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = f"{folder}: another {who} works in this folder"
            raise ApplrError(f"{problem}: wait, or give another --out") from None

    def close(self) -> None:
        """Release the folder for another process."""
        self._file.close()
