"""Tests of the folder with the bags of stops: whole or not at all, and bounded."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.why.black_box import folder as folder_module
from applr_ros1.why.black_box.bag_file import Publication, RawMessage, read_messages
from applr_ros1.why.black_box.folder import StopFolder
from tests.support import ROOT

SCAN = Publication("/scan", "sensor_msgs/LaserScan", "")
MESSAGES = [RawMessage(second * 10**9, SCAN, b"x" * 1000) for second in range(1, 20)]
GB = 10**9


@pytest.fixture
def folder(tmp_path):
    """Return a folder that does not exist yet."""
    return StopFolder(tmp_path / "black" / "box", 2 * GB, 500)


def names(folder):
    """Return the names of the files in a folder."""
    return sorted(path.name for path in folder.path.iterdir())


def test_a_stop_is_a_bag_in_a_folder_that_is_made(folder):
    bag_path = folder.save("2026-11-29_10-00-00", MESSAGES)
    assert bag_path.name == "stop_2026-11-29_10-00-00.bag"
    assert list(read_messages(bag_path.read_bytes())) == MESSAGES
    # Two stops of one second, or of a clock that was set back
    assert folder.save("2026-11-29_10-00-00", MESSAGES).name == "stop_2026-11-29_10-00-00_2.bag"


@pytest.mark.heavy
def test_the_oldest_bags_go_and_other_files_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda file: None)
    folder = StopFolder(tmp_path, 2 * GB, 500)
    mine = tmp_path / "my.bag"
    mine.write_bytes(b"mine")
    for number in range(510):
        bag_path = folder.save(f"{number:03}", MESSAGES[:1])
        # In the order of their making, however coarse the file system's clock is
        os.utime(bag_path, (number, number))
    bags = [name for name in names(folder) if name != mine.name]
    assert len(bags) == 500
    assert bags[0] == "stop_010.bag"
    assert mine.exists()


def test_the_size_of_all_bags_is_bounded_but_the_newest_one_stays(tmp_path):
    folder = StopFolder(tmp_path, 2 * GB, 500)
    first_bag = folder.save("0", MESSAGES)
    os.utime(first_bag, (0, 0))
    size = first_bag.stat().st_size
    bounded = StopFolder(tmp_path, 3 * size, 500)
    for number in range(1, 6):
        bag_path = bounded.save(str(number), MESSAGES)
        os.utime(bag_path, (number, number))
    assert names(bounded) == ["stop_3.bag", "stop_4.bag", "stop_5.bag"]
    tiny = StopFolder(tmp_path, 10, 500)
    tiny.save("6", MESSAGES)
    assert names(tiny) == ["stop_6.bag"]


def test_a_full_disk_is_one_line_and_leaves_the_folder_as_it_was(folder, monkeypatch):
    folder.save("first", MESSAGES)
    write_messages = folder_module.write_messages

    def fill_disk(file, messages):
        """Write half of a bag, then fail as a full disk does."""
        write_messages(file, messages[:5])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "write_messages", fill_disk)
    with pytest.raises(ApplrError) as refusal:
        folder.save("second", MESSAGES)
    path = folder.path / "stop_second.bag"
    assert str(refusal.value) == f"{path}: cannot be written (No space left on device)"
    assert names(folder) == ["stop_first.bag"]
    # The next stop is written when there is space again.
    monkeypatch.undo()
    folder.save("third", MESSAGES)
    assert names(folder) == ["stop_first.bag", "stop_third.bag"]


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder")
    with pytest.raises(ApplrError, match="file/below: cannot be used"):
        StopFolder(file / "below", 2 * GB, 500).save("first", MESSAGES)


KILLED = """
import sys, time
from pathlib import Path
from applr_ros1.why.black_box import folder as folder_module
from tests.why.black_box.test_folder import MESSAGES, GB
write_messages = folder_module.write_messages
def hang(file, messages):
    write_messages(file, messages[:5])
    file.flush()
    print("half", flush=True)
    time.sleep(60.0)
folder_module.write_messages = hang
folder_module.StopFolder(Path(sys.argv[1]), 2 * GB, 500).save("killed", MESSAGES)
"""


def test_a_node_that_is_killed_while_it_writes_leaves_nothing_under_a_bags_name(folder):
    folder.save("first", MESSAGES)
    program = [sys.executable, "-c", KILLED, str(folder.path)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout.readline() == b"half\n"
        # A running process is not disturbed.
        folder.save("second", MESSAGES)
        partial = f"stop_killed.bag.{process.pid}.partial"
        assert partial in names(folder)
        process.send_signal(signal.SIGKILL)
    assert not (folder.path / "stop_killed.bag").exists()
    folder.save("third", MESSAGES)
    assert names(folder) == ["stop_first.bag", "stop_second.bag", "stop_third.bag"]
