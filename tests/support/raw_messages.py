"""Serialised messages of drives, as they come to the black box, without ROS."""

import io

from rosbags.rosbag1 import Reader

from applr_ros1.why.black_box.answer_process import write_job
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from training.bags.maker import Maker
from training.bags.write import write

_MAKER = Maker()
_MAKER.register_own()


def raw_messages(path, drive, **options):
    """Return the messages of a drive, which is written to a bag at `path`."""
    messages = []
    with Reader(write(path, drive, **options)) as reader:
        for connection, time, data in reader.messages():
            publication = Publication(
                connection.topic,
                connection.msgtype.replace("/msg/", "/"),
                connection.digest,
                connection.msgdef.data,
            )
            messages.append(RawMessage(time, publication, bytes(data)))
    return messages


class Pipe(io.BytesIO):
    """Pipe that keeps what is written to it."""

    def seekable(self):
        return False


def job_of(stop, messages):
    """Return what the process that answers reads."""
    pipe = Pipe()
    write_job(pipe, stop, messages)
    return pipe.getvalue()


def deserialize(publication, data):
    """Return a message as an object."""
    return _MAKER.store.deserialize_ros1(data, publication.type.replace("/", "/msg/"))
