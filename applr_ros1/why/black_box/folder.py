"""Folder of the black box: a bag for each stop, whole or not at all, the oldest removed."""

from __future__ import annotations

import os
import re
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import Iterable, Iterator, List

from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.files import PARTIAL, written_whole
from applr_ros1.why.black_box.bag_file import (
    CHUNK_BYTES,
    HEADER_BYTES,
    RawMessage,
    write_messages,
)
from applr_ros1.why.black_box.description import TOPIC

MOMENT = "%Y-%m-%d_%H-%M-%S"  # form of the time in the name of a bag
BAG_NAME = r"stop_\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(?:_\d+)?\.bag"
# A bag that a killed node has not completed: NAME.PID.partial. Linux has at most 2^22 processes.
PARTIAL_NAME = BAG_NAME + r"\.(\d{1,7})" + re.escape(PARTIAL)
ROOM_BYTES = 4 * CHUNK_BYTES  # free space into which the next part of a bag surely fits [bytes]


def moment() -> str:
    """Return the present time of the computer for the name of a bag."""
    return time.strftime(MOMENT)


class StopFolder:
    """Bags of stops in a folder. What the black box has not written there is left alone.

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
            write_messages(file, self._with_room(messages))
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
            match = re.fullmatch(PARTIAL_NAME, path.name)
            if match and _is_regular(path) and not Path("/proc", match[1]).exists():
                path.unlink()

    def _with_room(self, messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
        """Yield messages. Meanwhile, remove the oldest bags if the disk is full."""
        old_bags = self._bags()
        for message in messages:
            while old_bags and shutil.disk_usage(self.path).free < ROOM_BYTES:
                old_bags.pop(0).unlink()
            yield message

    def _bags(self) -> List[Path]:
        """Return the bags that a black box has written here, the oldest first."""
        bags = filter(_is_own, self.path.iterdir())
        return sorted(bags, key=lambda path: (path.stat().st_mtime, path.name))

    def _remove_oldest(self, newest: Path) -> None:
        """Remove the oldest bags beyond the limits, never the newest one."""
        bags = [path for path in self._bags() if path != newest]
        size = sum(path.stat().st_size for path in (newest, *bags))
        while bags and (len(bags) >= self._most_stops or size > self._most_bytes):
            oldest = bags.pop(0)
            size -= oldest.stat().st_size
            oldest.unlink()


def _is_own(path: Path) -> bool:
    """Return whether a black box has written a file: its name and its first message say so."""
    if not re.fullmatch(BAG_NAME, path.name) or not _is_regular(path):
        return False
    with suppress(OSError), path.open("rb") as file:
        return f"topic={TOPIC}".encode() in file.read(2 * HEADER_BYTES)
    return False


def _is_regular(path: Path) -> bool:
    """Return whether a path is a file itself, and no link to one."""
    return path.is_file() and not path.is_symlink()
