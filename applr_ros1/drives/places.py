"""Places of a recorded drive's laser, base and plans' frame, as tf says."""

from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np

from applr_ros1.drives.clocks import APART_S, stamped_later
from applr_ros1.drives.drive import Drive, Motion, Scans
from applr_ros1.drives.frames import FramePlacements, Link, Tree


class PlacedBase(NamedTuple):
    """Where tf has the robot's base.

    Attributes:
        link: Link with the most messages between the base and the drive's frame.
        later: By how much later the odometry is stamped than tf [s]; 0 if both have one clock.
        by_link: (m, 3) poses in the drive's frame at the link's messages.
        by_topic: (n, 3) poses in the frame of the odometry topic at its messages; None if tf does
            not connect it.
    """

    link: Link
    later: float
    by_link: np.ndarray
    by_topic: Optional[np.ndarray]


class Places(NamedTuple):
    """Places and frames of a drive, as tf says.

    Attributes:
        laser: Place of the laser on the robot; None if tf does not connect them.
        base: Where the base is; None if nothing moves it.
        is_framed: Whether tf connects the drive's frame with the base.
    """

    laser: Optional[FramePlacements]
    base: Optional[PlacedBase]
    is_framed: bool


def places_of(drive: Drive, tree: Tree, odometry: Motion, scans: Scans, base: str) -> Places:
    """Return what tf says of a drive, whose odometry and scans have one frame each.

    Args:
        drive: The drive. Its frame is that in which poses are wanted.
        tree: Its frames.
        odometry: Its odometry.
        scans: Its scans.
        base: Frame of the robot's base.
    """
    (laser_frame,) = drive.frames["scans"]
    (topic_frame,) = drive.frames["odometry"]
    return Places(
        laser=tree.place(base, laser_frame, scans.stamp[:1]),
        base=_placed_base(tree, odometry, topic_frame, drive.frame, base),
        is_framed=tree.place(drive.frame, base, np.zeros(1)) is not None,
    )


def _placed_base(
    tree: Tree, odometry: Motion, topic_frame: str, frame: str, base: str
) -> Optional[PlacedBase]:
    """Return where tf has the base, as Costmap2DROS::getRobotPose does, or None if it does not."""
    link = tree.busiest(frame, base)
    if link is None:
        return None
    later = stamped_later(odometry, link)
    if abs(later) <= APART_S:
        later = 0.0
    at_link = tree.place(frame, base, link.stamp)
    at_topic = tree.place(topic_frame, base, odometry.stamp - later)
    if at_link is None:
        return None
    return PlacedBase(
        link=link,
        later=later,
        by_link=at_link.planar,
        by_topic=None if at_topic is None else at_topic.planar,
    )
