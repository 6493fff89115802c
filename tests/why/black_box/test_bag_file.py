"""Tests of bags that are written without ROS, read by the library rosbags."""

import io

import pytest
from rosbags.rosbag1 import Reader

from applr_ros1.why.black_box import bag_file
from applr_ros1.why.black_box.bag_file import (
    Publication,
    RawMessage,
    write_messages,
)

FLAG = Publication(
    "/flag", "std_msgs/Bool", "8b94c1b53db61fb6aed406028ad6332a", "bool data\n", "/a"
)
SAME_OF_ANOTHER = FLAG._replace(publisher="/b", is_latched=True)
TEXT = Publication(
    "/text", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n", "/a"
)
MESSAGES = [
    RawMessage(1_700_000_000_000_000_005, FLAG, b"\1"),
    RawMessage(1_700_000_000_500_000_000, TEXT, b"\2\0\0\0ab"),
    RawMessage(1_700_000_001_000_000_000, SAME_OF_ANOTHER, b"\0"),
    RawMessage(1_700_000_002_000_000_000, FLAG, b"\0"),
]


def written(messages):
    """Return a bag with messages."""
    file = io.BytesIO()
    write_messages(file, messages)
    return file.getvalue()


@pytest.mark.parametrize("chunk_bytes", [1, 10_000])
def test_rosbags_reads_what_was_written(tmp_path, monkeypatch, chunk_bytes):
    monkeypatch.setattr(bag_file, "CHUNK_BYTES", chunk_bytes)
    bag_path = tmp_path / "stop.bag"
    bag_path.write_bytes(written(MESSAGES))

    with Reader(bag_path) as reader:
        read_back = list(reader.messages())
        counts = {connection.topic: connection.msgcount for connection in reader.connections}

    assert [(time, bytes(data)) for _, time, data in read_back] == [
        (message.time, message.data) for message in MESSAGES
    ]
    for (connection, _, _), message in zip(read_back, MESSAGES, strict=True):
        publication = message.publication
        assert connection.topic == publication.topic
        assert connection.msgtype == publication.type.replace("/", "/msg/")
        assert connection.digest == publication.md5sum
        assert connection.ext.callerid == publication.publisher
        assert connection.ext.latching == int(publication.is_latched)
    assert counts["/text"] == 1


def test_a_bag_without_messages_is_a_bag(tmp_path):
    bag_path = tmp_path / "empty.bag"
    bag_path.write_bytes(written([]))
    with Reader(bag_path) as reader:
        assert not list(reader.messages())
