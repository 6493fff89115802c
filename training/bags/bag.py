"""The content of a bag, ROS 1 or ROS 2, as arrays: what a robot with move_base recorded of its drives.

episodes.py makes transitions of it, APPLD its demonstrations.
"""

from __future__ import annotations

import json
import zipfile
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

import numpy as np
import rosbags  # noqa: F401  (messages.py's process needs it)

from applr_ros1.common import child
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.policy.decision import Seen
from training.bags.topics import TopicNames
from training.common.command_line import AnyRobot
from training.common.options import Options, option

LIMITS = {"CPU": 60, "AS": 2**32, "FSIZE": 2**32, "NPROC": 0}  # s, bytes, bytes of a file that is written, processes
SECONDS_PER_GB = 200.0  # of a bag, beside LIMITS
METADATA, STORAGES = "metadata.yaml", (".mcap", ".db3")  # of a ROS 2 bag


class BagError(ApplrError):
    """A bag that cannot be used as a whole; one line with which and why."""


class BagOptions(Options):
    """The robot that bags are of, and the topics on which they hold what it recorded."""

    robot: AnyRobot
    scan: str = option("", "Topic of the laser scans in the bags. Default: the robot's.")
    odometry: str = option("", "Topic of the odometry in the bags. Default: the robot's.")
    command: str = option("", "Topic of the velocity commands in the bags. Default: the robot's.")

    def topics(self) -> TopicNames:
        """Return the robot's topics, and what is given instead."""
        given = {name: value for name, value in self if value and hasattr(TopicNames, name)}
        return replace(TopicNames.of(self.robot), **given)


class Poses(NamedTuple):
    """Odometry: at (n,), stamp (n,), pose (n, 3) x, y [m], yaw [rad], twist (n, 2) v [m/s], w [rad/s], its frame."""

    at: np.ndarray
    stamp: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    frame: str


class Scans(NamedTuple):
    """Scans: at (n,), stamp (n,), nearest (n,) smallest range [m], NaN for none; geometry, ranges.

    geometry (n, 4): angle of the first range and between ranges [rad], smallest and largest range [m]. ranges: float32
    [m] of all scans, one behind the other, as the laser gave them; scan i begins at starts[i]. Empty where not asked.
    """

    at: np.ndarray
    stamp: np.ndarray
    nearest: np.ndarray
    geometry: np.ndarray
    starts: np.ndarray
    ranges: np.ndarray

    def of(self, i: int) -> np.ndarray:
        """Return the ranges (m,) of scan i, which share the memory of all."""
        return self.ranges[self.starts[i] : self.starts[i + 1]]


class Decision(NamedTuple):
    """A decision of the applr node, as msg/Decision.msg has it; times in ns, parameters {name: value}.

    In a bag of an older node, whose decisions held an observation of one form alone, seen has a scan without ranges.
    """

    at: int
    number: int
    goal: str
    stamp: int
    odometry: int
    before: Dict[str, float]
    after: Dict[str, float]
    seen: Seen


@dataclass
class Bag:
    """The content of a bag in order of recording.

    Times are int64 nanoseconds. `at` is when a message was recorded, `stamp` is the time in its header.

    Attributes:
        goals: (at, frame, x, y, yaw) of each message with a goal.
        status: (at, id of the running goal or "").
        results: By id of a goal when it ended, and its actionlib status.
        commands: (n,) times and (n, 2) v [m/s], w [rad/s].
        ends: What the applr node saw where courses ended, with what the planner had before.
        source: Who demonstrated, and where.
        collisions: When a contact was reported.
        end: Time of the last message.
    """

    path: Path
    topics: TopicNames
    scans: Scans
    odometry: Poses
    commands: Tuple[np.ndarray, np.ndarray]
    goals: List[Tuple[int, str, float, float, float]]
    status: List[Tuple[int, str]]
    results: Dict[str, Tuple[int, int]]
    decisions: List[Decision]
    ends: List[Decision]
    collisions: List[int]
    source: Dict[str, Any]
    end: int


def read(path, topics: TopicNames = TopicNames(), ranges: bool = True) -> Bag:
    """Read a bag in a child process with limits of memory and time.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or a file in it.
        topics: Names of what was recorded.
        ranges: Whether the ranges of scans are wanted.

    Raises:
        BagError: It cannot be read, or reading it takes too much.
    """
    place = Path(path)
    if (place.suffix in STORAGES or place.name == METADATA) and (place.parent / METADATA).exists():
        place = place.parent
    size = sum(file.stat().st_size for file in (place.iterdir() if place.is_dir() else [place]) if file.exists())
    limits = {**LIMITS, "CPU": int(LIMITS["CPU"] + SECONDS_PER_GB * size / 1e9)}
    given = {"path": str(place), "topics": vars(topics), "ranges": ranges}
    environment = {"OPENBLAS_NUM_THREADS": "1"}
    with TemporaryDirectory() as folder, open(Path(folder) / "answer.npz", "w+b") as answer:
        program, patience_s = str(Path(__file__).with_name("messages.py")), 60.0 + 4.0 * limits["CPU"]
        if child.run([program], given, limits, patience_s, answer, {**environment, "TMPDIR": folder}) is None:
            too_much = f"over {limits['CPU']} s or {limits['AS'] >> 20} MiB"
            raise BagError(f"{path}: reading it takes {too_much}; record fewer topics, or shorter")
        answer.seek(0)
        try:
            with np.load(answer, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except (ValueError, zipfile.BadZipFile) as error:
            raise BagError(f"{path}: what was read of it is incomplete ({error}); is the disk full?") from None
    about = json.loads(arrays["about"].tobytes())
    if "error" in about:
        remedy = "; it was not closed: give it the ending .bag" if place.suffix == ".active" else ""
        raise BagError(f"{path}: {about['error']}{remedy}")
    return _bag(Path(path), topics, about, arrays)


def _bag(path: Path, topics: TopicNames, about: Dict[str, Any], arrays: Dict[str, np.ndarray]) -> Bag:
    """Return a Bag of what messages.py answers."""

    def table(name: str, *columns: str) -> Dict[str, np.ndarray]:
        return {column: arrays[f"{name}_{column}"] for column in columns}

    starts = np.concatenate([[0], np.cumsum(arrays["scan_count"])])
    scan = table("scan", "at", "stamp", "nearest", "geometry")
    for name in ("decisions", "ends"):
        about[name] = [
            Decision._make([*known, dict(zip(*before)), dict(zip(*after)), _seen(arrays["seen"], places)])
            for *known, before, after, places in about[name]
        ]
    return Bag(
        path,
        topics,
        Scans(**scan, starts=starts, ranges=arrays["ranges"]),
        Poses(**table("odometry", "at", "stamp", "pose", "twist"), frame=about.pop("frame")),
        (arrays["command_at"], arrays["command_command"]),
        **about,
    )


def _seen(numbers: np.ndarray, places: List[int]) -> Seen:
    """Return what a decision was made from, of the numbers that messages.py puts one behind the other."""
    single, ranges, plan, movers = (numbers[begin:end] for begin, end in zip(places, places[1:]))
    time, x, y, yaw, v, w, goal_x, goal_y, goal_yaw, first, step = single.tolist()
    scan, where = (ranges.astype(np.float32), first, step), ((x, y, yaw), (v, w), (goal_x, goal_y, goal_yaw))
    return Seen(scan, time, *where, plan.reshape(2, -1).T, movers.reshape(4, -1).T)


@contextmanager
def refused(path) -> Iterator[None]:
    """Turn the errors of what makes sense of a bag into a BagError that names the bag."""
    try:
        yield
    except ApplrError as error:
        raise BagError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except Exception as error:  # what numbers that no drive has lead to can be anything
        raise BagError(f"{path}: damaged inside ({reason(error)})") from None


def bags_in(paths) -> List[Path]:
    """Return the bags among files and folders: .bag files, ROS 2 folders, and lone .mcap or .db3 files, sorted.

    Raises:
        BagError: A path does not exist, or there are no bags.
    """
    found = []
    for path in map(Path, paths):
        if not path.exists():
            raise BagError(
                f"{path}: there is no such file or folder; give .bag, .mcap or .db3 files or ROS 2 bag folders"
            )
        holds_bags = path.is_dir() and not (path / METADATA).exists()
        found += [inside for inside in sorted(path.rglob("*")) if _is_bag(inside)] if holds_bags else [path]
    if not found:
        raise BagError(
            f"{', '.join(map(str, paths))}: no bags there; give .bag, .mcap or .db3 files or ROS 2 bag folders"
        )
    return found


def _is_bag(path: Path) -> bool:
    if path.suffix in STORAGES:
        return not (path.parent / METADATA).exists()
    return path.name.endswith((".bag", ".bag.active")) or (path / METADATA).exists()
