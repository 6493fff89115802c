"""Poses of a nav_msgs/Path of ROS 1, all at once.

rosbags makes an object of each pose. A global planner publishes hundreds of poses up to twice per
control cycle, which made reading the slowest part of a replay: 10 of 12 s for a drive of 30 s.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Optional

import numpy as np

from applr_ros1.common.angles import yaws_of
from applr_ros1.common.arrays import Array
from applr_ros1.drives.columns import SECOND, Row, Stamp, path_row

# MD5 sum of the definition of nav_msgs/Path, by which a bag tells that it has no other definition.
DIGEST = "6227e2b7e9cce15051f669a5e197bbf7"
HEAD_BYTES = 16  # sequence number, stamp (two numbers), and length of the frame's name
COUNT_BYTES = 4  # number of an array's entries, or of a text's characters


def path_of(raw: bytes) -> Optional[Row]:
    """Return the row of a serialised path, with its poses (n, 3) x, y [m], yaw [rad].

    None if its poses are not equally long, or if it is damaged.
    """
    # Header: sequence number, stamp, and a text with its length in front
    serialised = bytes(raw)
    if len(serialised) < HEAD_BYTES:
        return None
    _, seconds, nanoseconds, frame_length = np.frombuffer(serialised, "<u4", 4).tolist()
    frame_end = HEAD_BYTES + frame_length
    body_begin = frame_end + COUNT_BYTES
    if len(serialised) < body_begin:
        return None
    stamp = Stamp(seconds * SECOND + nanoseconds)
    frame_name = serialised[HEAD_BYTES:frame_end].decode(errors="replace")
    frame = frame_name.lstrip("/")

    # Array of poses with their number in front
    pose_count = int.from_bytes(serialised[frame_end:body_begin], "little")
    if pose_count == 0:
        return path_row(stamp, frame, np.zeros((0, 3)))
    pose_bytes = serialised[body_begin:]
    if len(pose_bytes) % pose_count or len(pose_bytes) < pose_count * HEAD_BYTES:
        return None
    poses = _poses(pose_bytes, pose_count)
    if poses is None:
        return None
    return path_row(stamp, frame, poses)


def _poses(body: bytes, count: int) -> Optional[Array]:
    """Return the poses (n, 3) of serialised PoseStamped messages whose frames are equally long."""
    frame_length = int.from_bytes(body[HEAD_BYTES - COUNT_BYTES : HEAD_BYTES], "little")
    message_layout = _layout(frame_length)
    if len(body) != count * message_layout.itemsize:
        return None
    messages = np.frombuffer(body, message_layout)
    # Frames of different lengths may add up to the same number of bytes.
    if (messages["length"] != frame_length).any():
        return None
    numbers = messages["pose"]  # (n, 7) x, y, z and a quaternion x, y, z, w
    return np.column_stack([numbers[:, :2], yaws_of(numbers[:, 3:])])


@lru_cache(maxsize=8)
def _layout(frame_length: int) -> np.dtype:
    """Return the layout of a PoseStamped message whose frame has a name of this length.

    A bag has few frames, and making a layout takes as long as reading a short path.
    """
    return np.dtype(
        [
            ("head", "<u4", 3),
            ("length", "<u4"),
            ("frame", "u1", frame_length),
            ("pose", "<f8", 7),
        ]
    )
