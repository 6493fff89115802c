"""The one thread in which the move_base node uses its planner: control cycles, requests between.

Cycles begin at the control frequency, as in C++. The node's subscribers and services hand their work to this thread, so
nothing of the planner needs a lock, and a flood of requests delays a control cycle by one request at most.
"""

from __future__ import annotations

import time
from collections import deque
from concurrent.futures import CancelledError, Future, TimeoutError
from dataclasses import dataclass, field
from typing import Any, Callable, Deque, Optional

import rospy
from rospy.rostime import get_rostime_cond, is_wallclock

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.sensors import Clock

STALLED_S = 1.0  # s of wall time without a new value of a simulated clock after which the clock counts as stalled
LONGEST_DELAY_S = 0.2  # s for which a long request gives way to control cycles


@dataclass
class _Request:
    """Work for the planner's thread. `answered`: a caller waits for its value or error."""

    work: Callable[[], Any]
    cost: float
    answered: bool
    since: float = field(default_factory=time.monotonic)
    future: Future = field(default_factory=Future)


class PlannerThread:
    """Calls cycle(now) `frequency()` times a second of ROS time, from the thread that calls run().

    Args:
        cycle: One control cycle; now: rospy.Time.
        frequency: Returns the control frequency [Hz]; asked before every cycle.
        went_back: Called before the first cycle after the clock jumped back.
        stalled: Called once each time that a simulated clock stands still for STALLED_S seconds of wall time.
        failed: Called with the exception that a cycle raised; the next cycle comes all the same.
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
        self._requests: Deque[_Request] = deque()
        self._ended = False
        self._wake = get_rostime_cond()  # every /clock message notifies it too
        self.missed = 0  # cycles left out because an earlier one took too long

    def post(self, work: Callable[[], None]) -> None:
        """Have something short done in the planner's thread, soon and in order. An error that it raises is logged."""
        self._append(_Request(work, 0.0, answered=False))

    def ask(self, work: Callable[[], Any], cost: float = 0.0, patience: float = 5.0) -> Any:
        """Have work() done in the planner's thread, and return its value or raise its error.

        Args:
            work: What to do.
            cost: How long it takes [s]; work that would delay the next cycle waits until after it.
            patience: Wall time [s] within which the work has to begin.

        Raises:
            ApplrError: The work did not begin within `patience`. It is withdrawn: it will not run later.
        """
        request = _Request(work, cost, answered=True)
        self._append(request)
        try:
            return request.future.result(patience)
        except TimeoutError:
            if request.future.cancel():
                raise ApplrError(f"move_base did not answer within {patience:g} s") from None
            return request.future.result()  # work that has begun is waited for: its changes must not go unreported
        except CancelledError:
            raise ApplrError("move_base is shutting down") from None

    def run(self) -> None:
        """Until the node is shut down. Requests that wait at that moment raise ApplrError."""
        try:
            self._run()
        finally:
            self._ended = True
            while self._requests:
                self._requests.popleft().future.cancel()

    def _run(self) -> None:
        due: Optional[rospy.Time] = None
        clock, last_change, reported = Clock(), time.monotonic(), False
        while not rospy.is_shutdown():
            last = clock.now
            if clock.went_back():
                self._went_back()
            now = clock.now
            if now < last:
                due = None
            if now != last:
                last_change, reported = time.monotonic(), False
            elif not is_wallclock() and not reported and time.monotonic() - last_change > STALLED_S:
                reported = True
                self._stalled()
            if now.is_zero():  # simulated time that has not begun
                if not self._serve(1.0):
                    self._sleep(0.1)
                continue
            period = 1.0 / self._frequency()
            left = 0.0 if due is None else (due - now).to_sec()
            if left > 0.0:
                if not self._serve(left):
                    self._sleep(min(left, 0.1) if is_wallclock() else 0.1, now)
                continue
            due = self._next_due(due, now, period)
            try:
                self._cycle(now)
            except Exception as error:
                self._failed(error)
            self._serve_overdue()

    def _next_due(self, due: Optional[rospy.Time], now: rospy.Time, period: float) -> rospy.Time:
        """Return when the cycle after the one that begins now is due: a period [s] after this one was.

        After cycles that were missed it is a period from now.
        """
        step = rospy.Duration.from_sec(period)
        late = 0.0 if due is None else (now - due).to_sec()
        if due is None or late > period:
            self.missed += int(late / period)
            return now + step
        return due + step

    def _append(self, request: _Request) -> None:
        self._requests.append(request)
        if self._ended:
            request.future.cancel()
        with self._wake:
            self._wake.notify_all()

    def _serve(self, left: float) -> bool:
        """Do one request, unless it is long and would push the next cycle, `left` seconds away, too far."""
        if not self._requests:
            return False
        request = self._requests[0]
        if request.cost > left and time.monotonic() - request.since < LONGEST_DELAY_S:
            return False
        self._requests.popleft()
        if not request.future.set_running_or_notify_cancel():  # its caller waits no more
            return True
        try:
            request.future.set_result(request.work())
        except Exception as error:
            expected = request.answered and isinstance(error, (ValueError, OSError, rospy.ServiceException))
            if not expected:
                rospy.logerr("move_base: %s: %s", type(error).__name__, error)
            request.future.set_exception(error)
        return True

    def _serve_overdue(self) -> None:
        """Do one request that has waited for too long: cycles that are longer than their period leave no other time."""
        if self._requests and time.monotonic() - self._requests[0].since > LONGEST_DELAY_S:
            self._serve(0.0)

    def _sleep(self, seconds: float, since: Optional[rospy.Time] = None) -> None:
        with self._wake:
            # what came between the look at the clock and here must not be slept through
            if (since is None or rospy.get_rostime() == since or is_wallclock()) and (
                not self._requests or self._requests[0].cost > 0.0
            ):
                self._wake.wait(seconds)
