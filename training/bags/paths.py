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


def path_of(raw: bytes) -> Optional[Tuple[int, str, np.ndarray]]:
    """Return stamp [ns], frame and poses (n, 3) x, y [m], yaw [rad] of a serialised path.

    None if its poses are not equally long, or if it is damaged.
    """
    data = bytes(raw)
    if len(data) < HEAD_BYTES:
        return None
    _, seconds, nanoseconds, length = np.frombuffer(data, "<u4", 4).tolist()
    begin = HEAD_BYTES + length
    if len(data) < begin + 4:
        return None
    frame = data[HEAD_BYTES:begin]
    count = int.from_bytes(data[begin : begin + 4], "little")
    body = data[begin + 4 :]
    if count == 0:
        poses = np.zeros((0, 3))
    elif len(body) % count or len(body) < count * HEAD_BYTES:
        return None
    else:
        poses_or_none = _poses(body, count)
        if poses_or_none is None:
            return None
        poses = poses_or_none
    return seconds * SECOND + nanoseconds, frame.decode(errors="replace").lstrip("/"), poses


def _poses(body: bytes, count: int) -> Optional[np.ndarray]:
    """Return the poses (n, 3) of serialised PoseStamped messages whose frames are equally long."""
    length = int.from_bytes(body[HEAD_BYTES - 4 : HEAD_BYTES], "little")
    if len(body) != count * (HEAD_BYTES + length + 7 * 8):
        return None
    layout = [("head", "<u4", 3), ("length", "<u4"), ("frame", "u1", length), ("pose", "<f8", 7)]
    rows = np.frombuffer(body, np.dtype(layout))
    if (rows["length"] != length).any():
        return None
    x, y, _, qx, qy, qz, qw = rows["pose"].T
    # Yaw as in common.angles.yaw_of.
    sine = 2.0 * (qx * qy + qw * qz)
    cosine = qw * qw + qx * qx - qy * qy - qz * qz
    return np.column_stack([x, y, np.arctan2(sine, cosine)])
