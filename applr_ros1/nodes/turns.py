"""One thread for everything that touches the planner: the cycle when ROS time says so, requests in between.

The move_base node's callbacks and services hand their work to it, so nothing of the planner needs a lock and a
flood of requests delays a cycle by one request at most.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Callable

import rospy
from rospy.rostime import get_rostime_cond, is_wallclock

STALLED = 1.0  # s of wall time without news of the clock
ADJUSTED = 1.0  # s by which a wall clock may be set back without anything being dropped
WAITED = 0.2  # s after which a long request is done even close to the next cycle


class Busy(RuntimeError):
    """The thread did not come to a request in time, or the node is shutting down."""


class _Request:
    __slots__ = ("work", "done", "value", "error", "cost", "since")

    def __init__(self, work, cost):
        self.work, self.cost, self.since = work, cost, time.monotonic()
        self.done, self.value, self.error = threading.Event(), None, None


class Turns:
    """cycle(now: rospy.Time) is called `frequency()` times a second of ROS time from run()'s thread.

    went_back(): before the first cycle after the clock jumped back. stalled(): once each time the clock stands
    still for STALLED seconds. failed(error): a cycle raised; the next one comes all the same.
    """

    def __init__(
        self, cycle: Callable, frequency: Callable[[], float], went_back: Callable, stalled: Callable, failed: Callable
    ):
        self._cycle, self._frequency = cycle, frequency
        self._went_back, self._stalled, self._failed = went_back, stalled, failed
        self._requests: deque = deque()
        self._wake = get_rostime_cond()  # also notified by every /clock message
        self.missed = 0  # cycles left out because an earlier one took too long

    def post(self, work: Callable[[], None]) -> None:
        """Have something short done in the thread, soon and in order."""
        self._requests.append(_Request(work, 0.0))
        with self._wake:
            self._wake.notify_all()

    def ask(self, work: Callable, cost: float = 0.0, patience: float = 5.0):
        """Have work() done in the thread and return its value or raise its error. `cost`: how long it takes [s]."""
        request = _Request(work, cost)
        self._requests.append(request)
        with self._wake:
            self._wake.notify_all()
        if not request.done.wait(patience):
            raise Busy("move_base did not answer within %g s" % patience)
        if request.error is not None:
            raise request.error
        return request.value

    def run(self) -> None:
        """Until the node is shut down."""
        due, last = None, rospy.Time(0)
        heard, told = time.monotonic(), False
        while not rospy.is_shutdown():
            now = rospy.get_rostime()
            if now < last:
                due = None
                if not is_wallclock() or (last - now).to_sec() > ADJUSTED:
                    self._went_back()
            if now != last:
                heard, told = time.monotonic(), False
            elif not is_wallclock() and not told and time.monotonic() - heard > STALLED:
                told = True
                self._stalled()
            last = now
            if now.is_zero():  # simulated time that has not begun
                self._serve(1.0) or self._sleep(0.1)
                continue
            left = 0.0 if due is None else (due - now).to_sec()
            if left > 0.0:
                self._serve(left) or self._sleep(min(left, 0.1) if is_wallclock() else 0.1, now)
                continue
            period = rospy.Duration.from_sec(1.0 / self._frequency())
            if due is not None and -left > period.to_sec():
                self.missed += 1
                due = None
            due = now + period if due is None else due + period
            try:
                self._cycle(now)
            except Exception as error:
                self._failed(error)

    def _serve(self, left: float) -> bool:
        """Do one request, unless it is long and would push the next cycle, `left` seconds away, too far."""
        if not self._requests:
            return False
        request = self._requests[0]
        if request.cost > left and time.monotonic() - request.since < WAITED:
            return False
        self._requests.popleft()
        try:
            request.value = request.work()
        except Exception as error:
            request.error = error
            if not isinstance(error, (ValueError, OSError, rospy.ServiceException)):
                rospy.logerr("move_base: %s: %s", type(error).__name__, error)
        request.done.set()
        return True

    def _sleep(self, seconds: float, since=None) -> None:
        with self._wake:
            # what came between the look at the clock and here must not be slept through
            if (since is None or rospy.get_rostime() == since or is_wallclock()) and (
                not self._requests or self._requests[0].cost > 0.0
            ):
                self._wake.wait(seconds)
