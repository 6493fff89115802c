"""Poses of a nav_msgs/Path of ROS 1, all at once.

rosbags makes an object of each pose. A global planner publishes hundreds of poses up to twice per
control cycle, which made reading the slowest part of a replay: 10 of 12 s for a drive of 30 s.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from training.bags import SECOND

# MD5 sum of the definition of nav_msgs/Path, by which a bag tells that it has no other definition.
DIGEST = "6227e2b7e9cce15051f669a5e197bbf7"
HEAD_BYTES = 16  # sequence number, stamp (two numbers), and length of the frame's name
COUNT_BYTES = 4  # number of an array's entries, or of a text's characters


def path_of(raw: bytes) -> Optional[Tuple[int, str, np.ndarray]]:
    """Return stamp [ns], frame and poses (n, 3) x, y [m], yaw [rad] of a serialised path.

    None if its poses are not equally long, or if it is damaged.
    """
    # Header: sequence number, stamp, and a text with its length in front
    data = bytes(raw)
    if len(data) < HEAD_BYTES:
        return None
    _, seconds, nanoseconds, length = np.frombuffer(data, "<u4", 4).tolist()
    frame_end = HEAD_BYTES + length
    body_begin = frame_end + COUNT_BYTES
    if len(data) < body_begin:
        return None
    stamp = seconds * SECOND + nanoseconds
    frame = data[HEAD_BYTES:frame_end].decode(errors="replace").lstrip("/")

    # Array of poses with their number in front
    count = int.from_bytes(data[frame_end:body_begin], "little")
    if count == 0:
        return stamp, frame, np.zeros((0, 3))
    body = data[body_begin:]
    if len(body) % count or len(body) < count * HEAD_BYTES:
        return None
    poses = _poses(body, count)
    if poses is None:
        return None
    return stamp, frame, poses


def _poses(body: bytes, count: int) -> Optional[np.ndarray]:
    """Return the poses (n, 3) of serialised PoseStamped messages whose frames are equally long."""
    length = int.from_bytes(body[HEAD_BYTES - COUNT_BYTES : HEAD_BYTES], "little")
    layout = np.dtype(
        [("head", "<u4", 3), ("length", "<u4"), ("frame", "u1", length), ("pose", "<f8", 7)]
    )
    if len(body) != count * layout.itemsize:
        return None
    rows = np.frombuffer(body, layout)
    # Frames of different lengths may add up to the same number of bytes.
    if (rows["length"] != length).any():
        return None
    x, y, _, qx, qy, qz, qw = rows["pose"].T
    # Yaw as in common.angles.yaw_of.
    sine = 2.0 * (qx * qy + qw * qz)
    cosine = qw * qw + qx * qx - qy * qy - qz * qz
    return np.column_stack([x, y, np.arctan2(sine, cosine)])
