"""Comparison of the clocks by which two sources of a drive stamp their messages."""

from __future__ import annotations

from typing import List, Protocol

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError

TF_BUFFER_S = 10.0  # time for which tf keeps transforms [s]
APART_S = 1.0  # difference of stamps from which on two clocks differ [s]


class Stamped(Protocol):
    """Messages with the times (n,) at which they came, and their stamps (n,) [s]."""

    time: Array
    stamp: Array


def stamped_later(messages: Stamped, others: Stamped) -> float:
    """Return by how much later messages are usually stamped than others that came with them [s]."""
    lead = float(np.median(messages.stamp - messages.time))
    return lead - float(np.median(others.stamp - others.time))


def clocks_differ(messages: str, later: float, others: str) -> str:
    """Return in words that messages are stamped `later` [s] than others."""
    direction = "after" if later > 0.0 else "before"
    return f"{messages} stamped {abs(later):,.1f} s {direction} {others}: the clocks differ"


def scans_apart(scans: Stamped, odometry: Stamped) -> str:
    """Return in words that scans have another clock than the odometry, with the remedy, or ""."""
    later = stamped_later(scans, odometry)
    if abs(later) <= APART_S:
        return ""
    return f"{clocks_differ('scans are', later, 'the odometry')}; {one_clock('laser')}"


def placed_late(scans: Stamped, odometry: Stamped) -> List[str]:
    """Return notes on the stamps of scans, compared with those of the poses that place them.

    Raises:
        ApplrError: tf's buffer holds no poses for the scans, so that costmap_2d drops them.
    """
    apart = scans_apart(scans, odometry)
    if not apart:
        return []
    if abs(stamped_later(scans, odometry)) > TF_BUFFER_S:
        raise ApplrError(f"{apart}, or tf drops the scans")
    return [apart]


def one_clock(device: str) -> str:
    """Return the remedy for a device with a clock of its own."""
    return f"set the driver of the {device} to the computer's time"
