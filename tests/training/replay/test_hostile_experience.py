"""What damaged or oversized bags and files do: one line, bounded memory."""

import bz2
import os
import struct
import tracemalloc

import lz4.frame
import pytest

from training import appld, bags_to_dataset, demonstrate, tune_robot
from training.bags import bag
from training.bags.writer import BagWriter
from training.baselines.appld.scripted_driver import Demonstrator


@pytest.mark.fault("23a")
@pytest.mark.parametrize(
    ("command", "arguments", "word"),
    [
        (appld, ["x.bag", "--out", "x.safetensors", "--seed", "-1"], "--seed"),
        (appld, ["nowhere.bag", "--out", "x.safetensors"], "nowhere.bag"),
        (bags_to_dataset, ["x.bag"], "--out"),
        (demonstrate, ["x.bag", "--seed", "-1"], "--seed"),
        (tune_robot, ["jackal", "--minutes", "0"], "--minutes"),
    ],
)
def test_mistakes_on_the_other_command_lines_are_one_line(command, arguments, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert word in error
    assert not list(tmp_path.iterdir())


# -- bags --------------------------------------------------------------------------------------------------------------
def bag_with_chunk(path, packed, method, message=b"bool data\n"):
    """A ROS 1 bag of one chunk of one connection."""

    def record(data=b"", **fields):
        head = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in fields.items())
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    u32, u64 = (lambda n: struct.pack("<I", n)), (lambda n: struct.pack("<Q", n))
    names = {"topic": b"/front/scan", "type": b"std_msgs/Bool", "md5sum": b"8b94c1b53db61fb6aed406028ad6332a"}
    definition = b"".join(
        struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v
        for n, v in dict(names, message_definition=message).items()
    )
    start = b"#ROSBAG V2.0\n"
    first = len(start) + 4096
    chunk = record(packed, op=b"\x05", compression=method, size=u32(2**31))
    index = record(u32(1) + u32(0) + u32(0), op=b"\x04", ver=u32(1), conn=u32(0), count=u32(1))
    times = {"start_time": u64(0), "end_time": u64(0)}
    tail = record(definition, op=b"\x07", conn=u32(0), topic=b"/front/scan")
    tail += record(u32(0) + u32(1), op=b"\x06", ver=u32(1), chunk_pos=u64(first), **times, count=u32(1))
    fields = {"index_pos": u64(first + len(chunk) + len(index)), "conn_count": u32(1), "chunk_count": u32(1)}
    bare = record(b"", op=b"\x03", **fields)
    path.write_bytes(start + record(b" " * (4096 - len(bare)), op=b"\x03", **fields) + chunk + index + tail)


@pytest.mark.fault("18a")
@pytest.mark.parametrize(
    ("method", "words"), [("bz2", "takes over .* or 1024 MiB"), ("lz4", "(takes over|Failed to resize buffer)")]
)
def test_a_bag_that_unpacks_to_too_much_is_one_line_in_little_memory(tmp_path, method, words, monkeypatch, measured):
    monkeypatch.setattr(bag, "LIMITS", {**bag.LIMITS, "AS": 2**30})
    piece = bytes(1 << 26)
    if method == "bz2":
        packed = bz2.compress(piece) * 16
    else:
        pack = lz4.frame.LZ4FrameCompressor()
        packed = b"".join([pack.begin(), *(pack.compress(piece) for _ in range(16)), pack.flush()])
    bag_with_chunk(tmp_path / "bomb.bag", packed, method.encode())
    tracemalloc.start()
    try:
        with pytest.raises(bag.BagError, match=f"bomb.bag: .*{words}"):
            bag.read(tmp_path / "bomb.bag")
        peak = tracemalloc.get_traced_memory()[1]
        measured("memory for an archive of 1 GiB, bound 1 GiB in a child", peak / 2**20, "MiB")
        assert peak < 1 << 24
    finally:
        tracemalloc.stop()


def test_code_in_a_message_definition_is_not_run(tmp_path):
    """ROS's own rosbag makes Python of such a constant's name."""
    code = f"uint8 {{0:open('{tmp_path}/ran','w')}}[0]=5\nbool data\n"
    for number, message in enumerate((code, code.replace("[0]=5", "=5"), f"string A={code[6:]}")):
        bag_with_chunk(tmp_path / f"{number}.bag", lz4.frame.compress(b""), b"lz4", message.encode())
        with pytest.raises(bag.BagError):
            bag.read(tmp_path / f"{number}.bag")
    assert not (tmp_path / "ran").exists()


def test_messages_of_another_definition_are_one_line(tmp_path):
    with BagWriter(tmp_path / "a.bag") as writer:
        writer.scan(1.0, [1.0] * 720)
        writer._put("/applr/decision", "std_msgs/msg/String", 1.0, "left")
    with pytest.raises(bag.BagError, match="a.bag: .*no attribute 'before'") as refused:
        bag.read(tmp_path / "a.bag")
    assert "\n" not in str(refused.value)


@pytest.mark.fault("18c")
def test_bags_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.bag")
    (tmp_path / "device.bag").symlink_to("/dev/zero")
    (tmp_path / "ros2").mkdir()
    os.mkfifo(tmp_path / "ros2" / "metadata.yaml")
    for name in ("pipe.bag", "device.bag", "ros2"):
        with pytest.raises(bag.BagError, match="is a pipe or device"):
            bag.read(tmp_path / name)


@pytest.mark.fault("18d")
def test_a_stopped_demonstration_leaves_no_bag(tmp_path, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Demonstrator, "command", stopped)
    part = tmp_path / "part.bag"
    assert demonstrate.main([str(part), "--world", "generated:0", "--simulator", "kinematic"]) == 130
    assert not part.exists()
