"""Control loop of the move_base node, at a fixed rate of ROS time as in C++, and the lock on its planner."""

from __future__ import annotations

import threading
from typing import Callable, Optional

import rospy
from rospy.rostime import get_rostime_cond, is_wallclock

from applr_ros1.nodes.sensors import Clock

STALLED_S = (
    1.0  # wall time after which a simulated clock that does not advance counts as stalled [s]
)
LOOK_S = 0.1  # maximum interval between two readings of the clock [s]


class ControlLoop:
    """Loop that calls cycle(now) `frequency()` times per second of ROS time, from the thread that calls run().

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
        self._cycle, self._frequency = cycle, frequency
        self._went_back, self._stalled, self._failed = went_back, stalled, failed
        self.lock, self.missed = threading.RLock(), 0

    def run(self) -> None:
        """Run cycles until the node is shut down."""
        due: Optional[rospy.Time] = None
        clock, stalled, tick = Clock(), False, get_rostime_cond()
        while not rospy.is_shutdown():
            last = clock.now
            if clock.went_back():
                with self.lock:
                    self._went_back()
            now, had_stalled, stalled = clock.now, stalled, clock.stands(STALLED_S)
            if now < last:
                due = None
            if stalled and not had_stalled:
                with self.lock:
                    self._stalled()
            left = LOOK_S if now.is_zero() else 0.0 if due is None else (due - now).to_sec()
            if left > 0.0:
                with tick:  # Every message on /clock notifies this condition variable.
                    if is_wallclock() or rospy.get_rostime() == now:
                        tick.wait(min(left, LOOK_S) if is_wallclock() else LOOK_S)
                continue
            due = self._next_due(due, now, 1.0 / self._frequency())
            with self.lock:
                try:
                    self._cycle(now)
                except Exception as error:
                    self._failed(error)

    def _next_due(self, due: Optional[rospy.Time], now: rospy.Time, period: float) -> rospy.Time:
        """Return when the next cycle is due: a period [s] after this cycle was due, or after now if it is late."""
        step = rospy.Duration.from_sec(period)
        late = 0.0 if due is None else (now - due).to_sec()
        if due is None or late > period:
            self.missed += int(late / period)
            return now + step
        return due + step
