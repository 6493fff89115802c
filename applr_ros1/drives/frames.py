"""Places of frames in each other, from recorded transforms (tf)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, List, NamedTuple, Optional

import numpy as np

from applr_ros1.common.angles import yaws_of
from applr_ros1.common.arrays import Array
from applr_ros1.drives.drive import Transforms

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

NO_TURN = (0.0, 0.0, 0.0, 1.0)  # quaternion of no rotation


def rotations(quaternions: Array) -> Rotation:
    """Return the rotations of quaternions (n, 4) x, y, z, w."""
    # The import takes half a second, and only bags with tf need it.
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions)


class FramePlacements(NamedTuple):
    """Places of a frame in another at n times.

    Attributes:
        position: (n, 3) x, y, z [m].
        rotation: n rotations.
    """

    position: Array
    rotation: Rotation

    @property
    def planar(self) -> Array:
        """Poses (n, 3) x, y [m], yaw [rad]."""
        return np.column_stack([self.position[:, :2], yaws_of(self.rotation.as_quat())])

    def compose(self, inner: FramePlacements) -> FramePlacements:
        """Return the places of a frame that `inner` places in this one."""
        position = self.position + self.rotation.apply(inner.position)
        return FramePlacements(position, self.rotation * inner.rotation)

    def inverse(self) -> FramePlacements:
        """Return the places of the outer frame in this one."""
        rotation = self.rotation.inv()
        return FramePlacements(-rotation.apply(self.position), rotation)


class Link:
    """Frame placed directly in another.

    Attributes:
        parent: The other frame.
        is_static: Whether the place does not change.
        time: (n,) times of recording [s].
        stamp: (n,) times for which the places hold, ascending [s].

    Args:
        transforms: Recorded transforms.
        rows: Rows of the frame's transforms, in order of recording.
    """

    def __init__(self, transforms: Transforms, rows: List[int]):
        # If a frame is placed in two others, tf takes the latest.
        self.parent = transforms.parent[rows[-1]]
        rows = [row for row in rows if transforms.parent[row] == self.parent]
        by_stamp = np.argsort(transforms.stamp[rows], kind="stable")
        ordered_rows = np.array(rows)[by_stamp]
        self.is_static = transforms.is_static[ordered_rows[-1]]
        self.time = transforms.time[ordered_rows]
        self.stamp = transforms.stamp[ordered_rows]
        self._place = transforms.place[ordered_rows]  # (n, 7) x, y, z, and a quaternion x, y, z, w

        # A quaternion and its opposite are one rotation; neighbours get one sign for interpolation.
        quaternions = self._place[:, 3:]
        products = (quaternions[1:] * quaternions[:-1]).sum(axis=1)
        changes_of_sign = np.where(products < 0.0, -1.0, 1.0)
        signs = np.cumprod(np.concatenate([[1.0], changes_of_sign]))
        quaternions *= signs[:, None]

    def at(self, stamps: Array) -> FramePlacements:
        """Return the places at some times (n,) [s], interpolated.

        Outside of the record, the nearest one holds.
        """
        if self.is_static:
            places = np.repeat(self._place[-1:], len(stamps), axis=0)
        else:
            columns = [np.interp(stamps, self.stamp, column) for column in self._place.T]
            places = np.column_stack(columns)
        return FramePlacements(places[:, :3], rotations(places[:, 3:]))


class FrameTree:
    """Frames and their links."""

    def __init__(self, transforms: Optional[Transforms]):
        self._links: Dict[str, Link] = {}
        if transforms is None:
            return
        rows_by_child: Dict[str, List[int]] = {}
        for row, child in enumerate(transforms.child):
            rows_by_child.setdefault(child, []).append(row)
        for child, rows in rows_by_child.items():
            self._links[child] = Link(transforms, rows)

    def place(self, outer: str, inner: str, stamps: Array) -> Optional[FramePlacements]:
        """Return the places of the frame `inner` in `outer` at some times (n,) [s].

        None if no links connect the frames.
        """
        common_frame = self._common(outer, inner)
        if common_frame is None:
            return None
        place_of_inner = self._below(common_frame, inner, stamps)
        if common_frame == outer:
            return place_of_inner
        return self._below(common_frame, outer, stamps).inverse().compose(place_of_inner)

    def busiest(self, outer: str, inner: str) -> Optional[Link]:
        """Return the link with the most messages between two frames, or None if nothing moves.

        Links that place the outer frame, as that of matched poses does, count only without others.
        """
        common_frame = self._common(outer, inner)
        if common_frame is None:
            return None
        for end_frame in (inner, outer):
            moving_links = []
            for frame in self._upwards(end_frame):
                # Above the common frame, links place both frames alike.
                if frame == common_frame:
                    break
                link = self._links[frame]
                if not link.is_static:
                    moving_links.append(link)
            if moving_links:
                return max(moving_links, key=lambda link: len(link.stamp))
        return None

    def _common(self, outer: str, inner: str) -> Optional[str]:
        """Return the lowest frame below which both frames are."""
        above_outer = self._upwards(outer)
        for frame in self._upwards(inner):
            if frame in above_outer:
                return frame
        return None

    def _upwards(self, frame: str) -> List[str]:
        """Return a frame and those that it is placed in. A damaged record may have a circle."""
        frames = [frame]
        while frame in self._links:
            frame = self._links[frame].parent
            if frame in frames:
                break
            frames.append(frame)
        return frames

    def _below(self, outer: str, inner: str, stamps: Array) -> FramePlacements:
        """Return the places of a frame in one of those above it."""
        time_count = len(stamps)
        # From the inner frame itself upwards, one link after the other
        no_rotations = rotations(np.tile(NO_TURN, (time_count, 1)))
        placement = FramePlacements(np.zeros((time_count, 3)), no_rotations)
        frame = inner
        while frame != outer:
            link = self._links[frame]
            placement = link.at(stamps).compose(placement)
            frame = link.parent
        return placement
