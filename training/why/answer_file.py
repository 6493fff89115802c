"""Keeps the answer to a bag in a JSON file beside it, so that a logbook continues where it stopped.

An answer counts only for the bag, the robot, the options and the code that made it. Nothing in the
file is executed.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence

import numpy as np
from pydantic import ValidationError

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, sha256, write_bytes
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from training.attempts.trials import Arrival
from training.common.provenance import source_hash
from training.evaluate.runner import content
from training.why.bag_answer import BagAnswer, Stored
from training.why.recorded import BagAnswerOptions
from training.why.values import thinned

ENDING = ".why.json"  # end of the file's name, after the bag's
BLOCK = 1 << 20  # part of a bag that is hashed at once [bytes]


class StoredArrival(Stored):
    """How a whole drive ended (Arrival), with fewer positions."""

    success: bool
    seconds: float
    is_slow: bool
    path: List[List[float]]

    @classmethod
    def of(cls, arrival: Arrival) -> StoredArrival:
        """Return a drive as plain values."""
        return cls(
            success=arrival.success,
            seconds=arrival.seconds,
            is_slow=arrival.is_slow,
            path=thinned(arrival.path),
        )

    @property
    def arrival(self) -> Arrival:
        """How the drive ended."""
        path = np.array(self.path, np.float32).reshape(-1, 3)
        return Arrival(self.success, self.seconds, self.is_slow, path)


class AnswerContent(Stored):
    """Content of a file.

    Attributes:
        key: Key of what made the answer.
        answer: The answer.
        drives: Simulated drives in the world of the bag, by key_of_drive; None for values that
            move_base refuses.
    """

    key: str
    answer: BagAnswer
    drives: Dict[str, Optional[StoredArrival]] = {}


class AnswerFile:
    """Answer to a bag that is kept beside it.

    Args:
        bag_path: The bag.
        key: Key of what makes the answer.

    Attributes:
        answer: The answer; None if it is not known yet.
        drives: Simulated drives, as in AnswerContent.
        is_damaged: Whether a file is there that is no answer.
        problem: Why the answer cannot be kept; "" if it can.
    """

    def __init__(self, bag_path: Path, key: str):
        self.bag_path = bag_path
        self.answer: Optional[BagAnswer] = None
        self.drives: Dict[str, Optional[StoredArrival]] = {}
        self.is_damaged = False
        self.problem = ""
        # The folder of a ROS 2 bag may be given as ".", which has no name.
        named_path = Path(os.path.abspath(bag_path))
        self._path = named_path.with_name(named_path.name + ENDING)
        self._key = key
        if not self._path.exists():
            return
        try:
            kept = AnswerContent.model_validate_json(read_bytes(self._path))
        except (ApplrError, ValidationError):
            self.is_damaged = True
            return
        # An answer to another bag, or of another state of the code, is made again.
        if kept.key == key:
            self.answer = kept.answer
            self.drives = dict(kept.drives)

    def save(self) -> None:
        """Write the file whole, if there is an answer and the folder can be written."""
        if self.answer is None or self.problem:
            return
        kept = AnswerContent(key=self._key, answer=self.answer, drives=self.drives)
        try:
            write_bytes(self._path, kept.model_dump_json().encode())
        except ApplrError as problem:
            self.problem = str(problem)


def key_of_drive(changes: Sequence[Change], seed: int, to_beat: float) -> str:
    """Return the key of a simulated drive with changes, a seed and a time to beat [s]."""
    changed_values = [[change.server, change.name, change.after] for change in changes]
    return json.dumps([changed_values, seed, to_beat])


def key_of_answers(options: BagAnswerOptions) -> str:
    """Return the key of all that the answers to bags depend on, beside the bags."""
    option_values = options.model_dump(mode="json", exclude={"robot"})
    given_options = sorted(options.model_fields_set)
    return sha256(
        source_hash(), _hash_of(options.robot), json.dumps(option_values), json.dumps(given_options)
    )


def bag_hash(path: Path) -> str:
    """Return the SHA-256 of a bag, which is a file, or a folder of files."""
    digest = hashlib.sha256()
    bag_files = [path]
    if path.is_dir():
        # Without folders, and without pipes, whose reading might never end
        bag_files = sorted(filter(Path.is_file, path.iterdir()))
    for bag_file in bag_files:
        digest.update(bag_file.name.encode() if path.is_dir() else b"")
        for block in _blocks_of(bag_file):
            digest.update(block)
    return digest.hexdigest()


def _blocks_of(path: Path) -> Iterator[bytes]:
    """Yield the content of a file in parts."""
    with path.open("rb") as file:
        while True:
            block = file.read(BLOCK)
            if not block:
                return
            yield block


def _hash_of(robot: Robot) -> str:
    """Return a hash of a robot and of the files in its folder, such as its policy."""
    file_hashes = [content(robot)]
    folder = Path(robot.folder)
    if folder.is_dir():
        for robot_file in sorted(folder.iterdir()):
            if robot_file.is_file():
                file_hashes.append(sha256(robot_file.name, read_bytes(robot_file)))
    return sha256(*file_hashes)
