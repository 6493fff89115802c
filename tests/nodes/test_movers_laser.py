"""Test of the laser that the movers node tracks if several share its topic."""

import numpy as np

from applr_ros1.common.scan import LaserScan
from applr_ros1.nodes.movers.node import TrackedLaser


def scan_of(frame, stamp):
    """Return an empty scan of a laser's frame at a time [s]."""
    return LaserScan(stamp, -1.0, 1.0, 0.1, 10.0, np.ones(3), (0.0, 0.0, 0.0), frame=frame)


def test_one_laser_is_tracked_until_it_falls_silent():
    laser = TrackedLaser()
    tracked = []
    changes = []

    def add(frame, stamp):
        scan = scan_of(frame, stamp)
        if laser.switches_to(scan):
            changes.append((frame, stamp))
        if laser.takes(scan):
            tracked.append((frame, stamp))

    # The first scan on the topic is that of a stray, which sends no more.
    add("stray", 0.0)
    for tenths in range(1, 30):
        add("front", tenths / 10)
        add("rear", tenths / 10 + 0.05)
    assert changes == [("stray", 0.0), ("rear", 1.05)]
    assert tracked[1:] == [("rear", tenths / 10 + 0.05) for tenths in range(10, 30)]

    # After a jump of the clock to an earlier time, the same laser is tracked, or else the next one.
    laser.forget_tracks()
    add("front", 0.5)
    add("rear", 0.6)
    assert changes[2:] == [("front", 0.5)]
    assert tracked[-1] == ("front", 0.5)
