"""What tf says of a recorded drive: where its base and its plans are."""

from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.arrays import Array
from applr_ros1.common.paths import distances
from applr_ros1.drives.clocks import APART_S, stamped_later
from applr_ros1.drives.drive import Commands, Drive, Motion
from applr_ros1.drives.frames import FrameTree, Link


class Apart(NamedTuple):
    """Largest distance [m] and angle [rad] between poses of two sources."""

    distance: float
    angle: float


class PlacedBase(NamedTuple):
    """Where tf has the robot's base.

    Attributes:
        link: Link with the most messages between the base and the drive's frame.
        later: By how much later the odometry is stamped than tf [s]; 0 if both have one clock.
        by_link: (m, 3) poses in the drive's frame at the link's messages.
        from_topic: How far the poses of the odometry topic are from those of tf in its frame; None
            if tf does not connect it.
    """

    link: Link
    later: float
    by_link: Array
    from_topic: Optional[Apart]


class RouteFrame(NamedTuple):
    """Poses (x, y, yaw) of the drive's frame in that of the global planner's plans.

    Attributes:
        at_commands: (n, 3) poses at the times of the planner's commands.
        at_routes: (m, 3) poses at the times of the plans.
    """

    at_commands: Array
    at_routes: Array


class Places(NamedTuple):
    """Places and frames of a drive, as tf says.

    Attributes:
        routes: Frame of the global planner's plans; None if there are none, if it is the drive's,
            or if tf does not connect it.
        is_framed: Whether tf connects the drive's frame with the base.
        base: Where the base is; None if nothing moves it.
    """

    routes: Optional[RouteFrame]
    is_framed: bool
    base: Optional[PlacedBase]


def places_of(drive: Drive, planned: Commands, odometry: Motion, base: str) -> Places:
    """Return what tf says of a drive, whose odometry has one frame.

    Args:
        drive: The drive. Its frame is that in which poses are wanted.
        planned: Its commands of the planner.
        odometry: Its odometry.
        base: Frame of the robot's base.
    """
    tree = FrameTree(drive.transforms)
    (topic_frame,) = drive.frames["odometry"]
    return Places(
        routes=route_frame(drive, tree, planned),
        is_framed=tree.place(drive.frame, base, np.zeros(1)) is not None,
        base=_placed_base(tree, odometry, topic_frame, drive.frame, base),
    )


def route_frame(drive: Drive, tree: FrameTree, planned: Commands) -> Optional[RouteFrame]:
    """Return the frame of the global planner's plans (Places.routes)."""
    routes = drive.routes
    if routes is None:
        return None
    plan_frame = drive.frames["routes"][0]
    if plan_frame == drive.frame:
        return None
    at_commands = tree.place(plan_frame, drive.frame, planned.time)
    at_routes = tree.place(plan_frame, drive.frame, routes.time)
    if at_commands is None or at_routes is None:
        return None
    return RouteFrame(at_commands.planar, at_routes.planar)


def _placed_base(
    tree: FrameTree, odometry: Motion, topic_frame: str, frame: str, base: str
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
        from_topic=None if at_topic is None else apart(odometry.pose, at_topic.planar),
    )


def apart(poses: Array, others: Array) -> Apart:
    """Return how far poses (n, 3) are from others (n, 3) at most."""
    turned_angles = normalize_angle_modulo(poses[:, 2] - others[:, 2])
    return Apart(
        distance=float(distances(poses[:, :2], others[:, :2]).max()),
        angle=float(np.abs(turned_angles).max()),
    )
