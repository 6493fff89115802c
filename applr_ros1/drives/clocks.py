"""Comparison of the clocks by which two sources of a drive stamp their messages."""

from __future__ import annotations

from typing import Protocol

import numpy as np

APART_S = 1.0  # difference of stamps from which on two clocks differ [s]


class Stamped(Protocol):
    """Messages with the times (n,) at which they came, and their stamps (n,) [s]."""

    time: np.ndarray
    stamp: np.ndarray


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


def one_clock(device: str) -> str:
    """Return the remedy for a device with a clock of its own."""
    return f"set the driver of the {device} to the computer's time"
