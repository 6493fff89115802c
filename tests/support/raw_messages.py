"""Serialised messages of drives, as they come to the black box, without ROS."""

import io
import marshal

from rosbags.rosbag1 import Reader

from applr_ros1.why.black_box.bag_file import Publication, RawMessage, write_messages
from applr_ros1.why.black_box.black_box import DESCRIPTION
from applr_ros1.why.black_box.description import text_of, with_stop
from tests.support.bags import write
from training.bags.maker import Maker

_MAKER = Maker()
_MAKER.register_own()


def raw_messages(path, drive, **options):
    """Return the messages of a drive, which is written to a bag at `path`."""
    return messages_in(write(path, drive, **options))


def messages_in(path):
    """Return the messages of a bag."""
    messages = []
    with Reader(path) as reader:
        for connection, time, data in reader.messages():
            publication = Publication(
                connection.topic,
                connection.msgtype.replace("/msg/", "/"),
                connection.digest,
                connection.msgdef.data,
            )
            messages.append(RawMessage(time, publication, bytes(data)))
    return messages


def piped(messages):
    """Return messages as the process that answers reads them."""
    return b"".join(
        marshal.dumps((time, tuple(publication), data)) for time, publication, data in messages
    )


def bag_of(messages):
    """Return the bag of messages."""
    bag = io.BytesIO()
    write_messages(bag, messages)
    return bag.getvalue()


def description_of(driven, time, stop=None):
    """Return the message at a time [ns] with the description of a robot and a stop."""
    text = text_of(driven)
    if stop is not None:
        text = with_stop(text, stop)
    data = text.encode()
    return RawMessage(time, DESCRIPTION, len(data).to_bytes(4, "little") + data)


def deserialize(publication, data):
    """Return a message as an object."""
    return _MAKER.store.deserialize_ros1(data, publication.type.replace("/", "/msg/"))
