"""Tests of the folder with the bags of stops: whole or not at all, and bounded."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.why.black_box import folder as folder_module
from applr_ros1.why.black_box.bag_file import (
    Publication,
    RawMessage,
    write_messages,
)
from applr_ros1.why.black_box.black_box import DESCRIPTION
from applr_ros1.why.black_box.folder import ROOM_BYTES, StopFolder
from tests.support import ROOT, raw_messages

SCAN = Publication("/scan", "sensor_msgs/LaserScan", "")
SCANS = [RawMessage(second * 10**9, SCAN, b"x" * 1000) for second in range(1, 20)]
# The black box describes the robot first.
MESSAGES = [RawMessage(10**9, DESCRIPTION, b"a robot"), *SCANS]
GB = 10**9
DAY = "2026-11-29"


@pytest.fixture
def folder(tmp_path):
    """Return a folder that does not exist yet."""
    return StopFolder(tmp_path / "black" / "box", 2 * GB, 500)


def names(folder):
    """Return the names of the files in a folder."""
    return sorted(path.name for path in folder.path.iterdir())


def moment(number):
    """Return the moment of the bag of a number."""
    minutes, seconds = divmod(number, 60)
    return f"{DAY}_10-{minutes:02}-{seconds:02}"


def bag_of(number):
    """Return the name of the bag of a number."""
    return f"stop_{moment(number)}.bag"


def test_a_stop_is_a_bag_in_a_folder_that_is_made(folder):
    bag_path = folder.save(moment(0), MESSAGES)
    assert bag_path.name == "stop_2026-11-29_10-00-00.bag"
    assert bag_path.read_bytes() == raw_messages.bag_of(MESSAGES)
    # Two stops of one second, or of a clock that was set back
    assert folder.save(moment(0), MESSAGES).name == "stop_2026-11-29_10-00-00_2.bag"


@pytest.mark.parametrize("bound", ["number", "size"])
def test_the_oldest_bags_go_beyond_a_number_and_a_size_but_the_newest_one_stays(tmp_path, bound):
    first_bag = StopFolder(tmp_path, 2 * GB, 500).save(moment(0), MESSAGES)
    size = first_bag.stat().st_size
    limits = (2 * GB, 3) if bound == "number" else (3 * size, 500)
    for number in range(1, 6):
        # In the order of their making, however coarse the file system's clock is
        os.utime(tmp_path / bag_of(number - 1), (number, number))
        StopFolder(tmp_path, *limits).save(moment(number), MESSAGES)
    bounded = StopFolder(tmp_path, 10, 500)
    assert names(bounded) == [bag_of(3), bag_of(4), bag_of(5)]
    bounded.save(moment(6), MESSAGES)
    assert names(bounded) == [bag_of(6)]


def bag_without_description(path):
    """Write a bag that somebody recorded."""
    with path.open("wb") as file:
        write_messages(file, SCANS)


FOREIGN = {
    # A bag that somebody has renamed
    "stop_by_the_door.bag": lambda path: path.write_bytes(path.with_name(bag_of(0)).read_bytes()),
    # Names that are not of the black box's form, or are too large for a process
    "stop_sign_training.bag": Path.touch,
    f"{bag_of(1)}.99999999999999999999.partial": Path.touch,
    f"{bag_of(1)}.4194304.partial": Path.mkdir,
    # Its names, but not its files
    bag_of(1): bag_without_description,
    bag_of(2): lambda path: path.write_bytes(b"#ROSBAG V2.0\nbut nothing more"),
    bag_of(3): lambda path: path.symlink_to("/nonexistent/file"),
    bag_of(4): lambda path: path.symlink_to(path.with_name(bag_of(0))),
    bag_of(5): Path.mkdir,
    bag_of(6): os.mkfifo,
}


def test_what_the_black_box_has_not_written_neither_counts_nor_goes(tmp_path):
    StopFolder(tmp_path, 2 * GB, 500).save(moment(0), MESSAGES)
    for name, make in FOREIGN.items():
        make(tmp_path / name)
    # What a killed process of the black box has left is its own.
    (tmp_path / f"{bag_of(7)}.4194304.partial").touch()
    tiny = StopFolder(tmp_path, 10, 1)
    tiny.save(moment(8), MESSAGES)
    assert names(tiny) == sorted([*FOREIGN, bag_of(8)])


def test_on_a_full_disk_the_oldest_bags_make_room_for_the_newest(folder, monkeypatch):
    # Given: three bags on a disk that one of them fills
    for number in range(3):
        bag_path = folder.save(moment(number), MESSAGES)
        os.utime(bag_path, (number, number))

    def disk_usage(path):
        """Return the usage of the disk of a folder."""
        return SimpleNamespace(free=ROOM_BYTES - len(list(path.glob("*.bag"))) + 2)

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)
    # When: a stop is written
    folder.save(moment(3), MESSAGES)
    # Then: the oldest bag is gone, and the others stay
    assert names(folder) == [bag_of(1), bag_of(2), bag_of(3)]


def test_a_full_disk_is_one_line_and_leaves_the_folder_as_it_was(folder, monkeypatch):
    folder.save(moment(1), MESSAGES)

    def fill_disk(file, messages):
        """Write half of a bag, then fail as a full disk does."""
        write_messages(file, islice(messages, 5))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "write_messages", fill_disk)
    with pytest.raises(ApplrError) as refusal:
        folder.save(moment(2), MESSAGES)
    path = folder.path / bag_of(2)
    assert str(refusal.value) == f"{path}: cannot be written (No space left on device)"
    assert names(folder) == [bag_of(1)]
    # The next stop is written when there is space again.
    monkeypatch.undo()
    folder.save(moment(3), MESSAGES)
    assert names(folder) == [bag_of(1), bag_of(3)]


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder")
    with pytest.raises(ApplrError, match="file/below: cannot be used"):
        StopFolder(file / "below", 2 * GB, 500).save(moment(1), MESSAGES)


KILLED = """
import sys, time
from itertools import islice
from pathlib import Path
from applr_ros1.why.black_box import folder as folder_module
from tests.why.black_box.test_folder import MESSAGES, GB, moment
write_messages = folder_module.write_messages
def hang(file, messages):
    write_messages(file, islice(messages, 5))
    file.flush()
    print("half", flush=True)
    time.sleep(60.0)
folder_module.write_messages = hang
folder_module.StopFolder(Path(sys.argv[1]), 2 * GB, 500).save(moment(9), MESSAGES)
"""


def test_a_node_that_is_killed_while_it_writes_leaves_nothing_under_a_bags_name(folder):
    folder.save(moment(1), MESSAGES)
    program = [sys.executable, "-c", KILLED, str(folder.path)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout.readline() == b"half\n"
        # A running process is not disturbed.
        folder.save(moment(2), MESSAGES)
        partial = f"{bag_of(9)}.{process.pid}.partial"
        assert partial in names(folder)
        process.send_signal(signal.SIGKILL)
    assert not (folder.path / bag_of(9)).exists()
    folder.save(moment(3), MESSAGES)
    assert names(folder) == [bag_of(1), bag_of(2), bag_of(3)]
