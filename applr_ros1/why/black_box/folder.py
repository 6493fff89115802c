"""Folder of the black box: a bag for each stop, whole or not at all, the oldest removed."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Iterable, List

from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.files import PARTIAL, written_whole
from applr_ros1.why.black_box.bag_file import RawMessage, write_messages

BAGS = "stop_*.bag"
# A bag that a killed node has not completed: NAME.PID.partial
PARTIAL_NAME = re.compile(r"stop_.*\.bag\.(\d+)" + re.escape(PARTIAL))


class StopFolder:
    """Bags of stops in a folder. Other files there are left alone.

    Args:
        path: The folder; made if it is missing.
        most_bytes: Largest size of all bags [bytes].
        most_stops: Largest number of bags.
    """

    def __init__(self, path: Path, most_bytes: int, most_stops: int):
        self.path = path
        self._most_bytes = most_bytes
        self._most_stops = most_stops

    def save(self, moment: str, messages: Iterable[RawMessage]) -> Path:
        """Write the bag stop_MOMENT.bag, remove the oldest ones, and return its path.

        Raises:
            ApplrError: The bag cannot be written; the folder is as it was.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._remove_partial_bags()
        except OSError as problem:
            raise ApplrError(f"{self.path}: cannot be used ({reason(problem)})") from None
        bag_path = self._free_path(moment)
        with written_whole(bag_path) as file:
            write_messages(file, messages)
        self._remove_oldest(bag_path)
        return bag_path

    def _free_path(self, moment: str) -> Path:
        """Return a path that no file has."""
        bag_path = self.path / f"stop_{moment}.bag"
        number = 2
        while os.path.lexists(bag_path):
            bag_path = self.path / f"stop_{moment}_{number}.bag"
            number += 1
        return bag_path

    def _remove_partial_bags(self) -> None:
        """Remove what processes that were killed have left."""
        for path in self.path.iterdir():
            match = PARTIAL_NAME.fullmatch(path.name)
            if match and not _is_running(int(match[1])):
                path.unlink()

    def _remove_oldest(self, newest: Path) -> None:
        """Remove the oldest bags beyond the limits, never the newest one."""
        bags = _by_age(list(self.path.glob(BAGS)))
        sizes = {path: path.stat().st_size for path in bags}
        for path in bags:
            is_within = len(sizes) <= self._most_stops and sum(sizes.values()) <= self._most_bytes
            if is_within:
                return
            if path != newest:
                path.unlink()
                del sizes[path]


def _by_age(bags: List[Path]) -> List[Path]:
    """Return bags, the oldest first."""
    return sorted(bags, key=lambda path: (path.stat().st_mtime, path.name))


def _is_running(pid: int) -> bool:
    """Return whether a process of this machine has a number."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # It is another user's.
        return True
    return True
