"""Bag of a logbook, with its answer in a JSON file beside it: a logbook continues where it stopped.

An answer counts only for the bag, the robot, the options and the code that made it. Nothing in the
file is executed.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import partial
from pathlib import Path
from typing import Optional, Sequence, Tuple

from pydantic import TypeAdapter, ValidationError

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, sha256, write_bytes
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from applr_ros1.why.answer import Answer
from training.attempts.trials import DriveConditions
from training.common.provenance import source_hash
from training.evaluate.runner import content
from training.why.recorded import BagAnswerOptions

ENDING = ".why.json"  # end of the file's name, after the bag's
BLOCK = 1 << 20  # part of a bag that is hashed at once [bytes]
# A key of what made an answer, and the answer
KEPT: TypeAdapter[Tuple[str, Answer]] = TypeAdapter(Tuple[str, Answer])


class LoggedBag:
    """Bag of a logbook. The answer to it is kept beside it.

    Args:
        path: The bag.
        key: Key of what makes the answer.

    Attributes:
        path: The bag.
        is_answered: Whether the answer is known.
        answer: The answer, once it is known.
        conditions: Conditions of simulated drives in its world, if they are known.
        floor: Number of the frame that it shares with other bags.
        problem: Why the answer cannot be kept; "" if it can.
    """

    answer: Answer

    def __init__(self, path: Path, key: str):
        self.path = path
        self.is_answered = False
        self.conditions: Optional[DriveConditions] = None
        self.floor = 0
        self.problem = ""
        # The folder of a ROS 2 bag may be given as ".", which has no name.
        named_path = Path(os.path.abspath(path))
        self._file = named_path.with_name(named_path.name + ENDING)
        self._key = key
        if not self._file.exists():
            return
        try:
            kept_key, answer = KEPT.validate_json(read_bytes(self._file))
        except (ApplrError, ValidationError):
            return
        # An answer to another bag, or of another state of the code, is made again.
        if kept_key == key:
            self.answer = answer
            self.is_answered = True

    def keep(self, answer: Answer) -> None:
        """Take the answer, and keep it."""
        self.answer = answer
        self.is_answered = True
        self.save()

    def save(self) -> None:
        """Write the answer whole, if the folder can be written."""
        if self.problem:
            return
        try:
            write_bytes(self._file, KEPT.dump_json((self._key, self.answer)))
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
        with bag_file.open("rb") as file:
            for block in iter(partial(file.read, BLOCK), b""):
                digest.update(block)
    return digest.hexdigest()


def _hash_of(robot: Robot) -> str:
    """Return a hash of a robot and of the files in its folder, such as its policy."""
    file_hashes = [content(robot)]
    folder = Path(robot.folder)
    if folder.is_dir():
        for robot_file in sorted(folder.iterdir()):
            if robot_file.is_file():
                file_hashes.append(sha256(robot_file.name, read_bytes(robot_file)))
    return sha256(*file_hashes)
