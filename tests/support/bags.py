"""Bags as files: drives written to one, and the drive read from one."""

from pathlib import Path

from applr_ros1.drives.columns import TopicNames
from applr_ros1.robots import JACKAL
from training.bags.read import opened
from training.bags.write import BagWriter


def read(path, *args, **options):
    """Read the drive in a bag; the arguments are those of OpenBag.drive."""
    with opened(path) as bag:
        return bag.drive(*args, **options)


def write(path, *drives, robot=JACKAL, topics=None):
    """Write drives as a bag, one after the other, and return its path."""
    with BagWriter(path, robot, topics or TopicNames.of(robot)) as writer:
        for drive in drives:
            writer.write(drive)
    return Path(path)
