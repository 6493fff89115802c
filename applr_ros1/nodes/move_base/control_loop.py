"""Control loop of the move_base node, at a fixed rate of ROS time as in C++.

It has the lock on the node's planner.
"""

from __future__ import annotations

import threading
from typing import Callable, Optional

import rospy
from rospy.rostime import get_rostime_cond, is_wallclock

from applr_ros1.nodes.sensors import RosClock

# Wall time after which a simulated clock that does not advance counts as stalled [s]
STALLED_S = 1.0
LOOK_S = 0.1  # maximum interval between two readings of the clock [s]


class ControlLoop:
    """Loop that calls cycle(now) `frequency()` times per second of ROS time.

    The calls come from the thread that calls run().

    Args:
        cycle: Function of one control cycle, called with the rospy.Time.
        frequency: Function that returns the control frequency [Hz], called before every cycle.
        went_back: Called before the first cycle after the clock jumped back.
        stalled: Called once each time a simulated clock stops for STALLED_S seconds of wall time.
        failed: Called with an exception that a cycle raised. The loop goes on.

    Attributes:
        lock: Lock that is held during these calls. Other users of the planner must hold it, too.
        missed: Number of cycles skipped because an earlier one took too long.
    """

    def __init__(
        self,
        cycle: Callable[[rospy.Time], None],
        frequency: Callable[[], float],
        went_back: Callable[[], None],
        stalled: Callable[[], None],
        failed: Callable[[Exception], None],
    ):
        self._cycle = cycle
        self._frequency = frequency
        self._went_back = went_back
        self._stalled = stalled
        self._failed = failed
        self.lock = threading.RLock()
        self.missed = 0

    def run(self) -> None:
        """Run cycles until the node is shut down."""
        due_time = None  # None for a cycle that is due at once
        clock = RosClock()
        is_stalled = False
        while not rospy.is_shutdown():
            last_time = clock.now
            # This reads the clock anew.
            if clock.went_back():
                with self.lock:
                    self._went_back()
            now = clock.now
            # A wall clock that was set back a little counts as no jump.
            if now < last_time:
                due_time = None  # Otherwise the loop would wait until the clock is there again.
            had_stalled = is_stalled
            is_stalled = clock.stands(STALLED_S)
            if is_stalled and not had_stalled:
                with self.lock:
                    self._stalled()

            # A simulated clock is 0 until the first message on /clock.
            if now.is_zero() or (due_time is not None and due_time > now):
                self._wait(due_time, now)
                continue
            due_time = self.next_due(due_time, now, 1.0 / self._frequency())
            with self.lock:
                try:
                    self._cycle(now)
                except Exception as error:
                    self._failed(error)

    def _wait(self, due_time: Optional[rospy.Time], now: rospy.Time) -> None:
        """Wait until the next cycle is due, until the clock advances, or for LOOK_S seconds."""
        seconds = LOOK_S
        if is_wallclock() and due_time is not None:
            seconds = min((due_time - now).to_sec(), LOOK_S)
        # Every message on /clock notifies this condition variable.
        clock_condition = get_rostime_cond()
        with clock_condition:
            if is_wallclock() or rospy.get_rostime() == now:
                clock_condition.wait(seconds)

    def next_due(
        self, due_time: Optional[rospy.Time], now: rospy.Time, period: float
    ) -> rospy.Time:
        """Return when the next cycle is due.

        This is a period [s] after this cycle was due, or a period from now if this cycle is late by
        more than a period, as in ros::Rate.
        """
        period_duration = rospy.Duration.from_sec(period)
        if due_time is None:
            return now + period_duration
        delay = (now - due_time).to_sec()
        if delay <= period:
            return due_time + period_duration
        self.missed += int(delay / period)
        return now + period_duration
