"""The one thread in which the move_base node uses its planner: control cycles, requests between.

A cycle starts when a new scan can be placed, so that its command is made from what the robot sees now: around the time
at which it is due, which comes at the control frequency, whether scans come or not.

The node's subscribers and services hand their work to this thread, so nothing of the planner needs a lock, and a flood
of requests delays a control cycle by one request at most.
"""

from __future__ import annotations

import time
from collections import deque
from concurrent.futures import CancelledError, Future, TimeoutError
from dataclasses import dataclass, field
from typing import Any, Callable, Deque, Optional, Tuple

import rospy
from rospy.rostime import get_rostime_cond, is_wallclock

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.sensors import Clock

STALLED_S = 1.0  # s of wall time without a new value of a simulated clock after which the clock counts as stalled
LONGEST_DELAY_S = 0.2  # s for which a long request gives way to control cycles
EARLY_SHARE = 0.2  # of a period by which a new scan may start a cycle before it is due
WAIT_SHARE = 0.5  # of a period for which a cycle that is due waits for a scan that is expected by then
LATE_SHARE = 0.2  # of a period for which a scan may be late before it is expected no more
TICK_S = 1e-3  # s, less than any difference of times that counts


@dataclass
class _Request:
    """Work for the planner's thread. `answered`: a caller waits for its value or error."""

    work: Callable[[], Any]
    cost: float
    answered: bool
    since: float = field(default_factory=time.monotonic)
    future: Future = field(default_factory=Future)


class PlannerThread:
    """Calls cycle(now, turn) about `frequency()` times a second of ROS time, from the thread that calls run().

    Args:
        cycle: One control cycle. now: rospy.Time; turn: the same, or when it is due where a scan starts it earlier.
        frequency: Returns the control frequency [Hz]; asked before every cycle.
        went_back: Called before the first cycle after the clock jumped back.
        stalled: Called once each time that a simulated clock stands still for STALLED_S seconds of wall time.
        failed: Called with the exception that a cycle raised; the next cycle comes all the same.
        scan_is_ready: Returns whether a new scan can be placed; asked again after each call of wake().
        scan_times: Returns the ROS times [s] at which the newest scan came and at which the next one is expected; 0 for
            what is not known.
    """

    def __init__(
        self,
        cycle: Callable[[rospy.Time, rospy.Time], None],
        frequency: Callable[[], float],
        went_back: Callable[[], None],
        stalled: Callable[[], None],
        failed: Callable[[Exception], None],
        scan_is_ready: Callable[[], bool] = lambda: False,
        scan_times: Callable[[], Tuple[float, float]] = lambda: (0.0, 0.0),
    ):
        self._cycle, self._frequency = cycle, frequency
        self._went_back, self._stalled, self._failed = went_back, stalled, failed
        self._scan_is_ready, self._scan_times = scan_is_ready, scan_times
        self._news = False  # whether wake() was called since the last look
        self._requests: Deque[_Request] = deque()
        self._ended = False
        self._wake = get_rostime_cond()  # every /clock message notifies it too
        self.missed = 0  # cycles left out because an earlier one took too long

    def wake(self) -> None:
        """Look again whether a scan has become ready."""
        with self._wake:
            self._news = True
            self._wake.notify_all()

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
            self._news = False
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
            left = 0.0 if due is None else self._left(due.to_sec(), now.to_sec(), period)
            if left > 0.0:
                if not self._serve(left):
                    self._sleep(min(left, 0.1) if is_wallclock() else 0.1, now)
                continue
            turn, due = max(now, due or now), self._next_due(due, now, period)
            try:
                self._cycle(now, turn)
            except Exception as error:
                self._failed(error)
            self._serve_overdue()

    def _left(self, due: float, now: float, period: float) -> float:
        """Return the time [s] for which the next cycle still waits, at most.

        It starts with the scan that comes nearest to `due` [s]. Where scans come more seldom than cycles, it waits for
        the one that is expected within WAIT_SHARE.
        """
        came, expected = self._scan_times()
        ready = self._scan_is_ready()
        if expected - due < due - came - TICK_S if ready else expected <= due + WAIT_SHARE * period:
            return max(due, expected + LATE_SHARE * period) - now
        return due - now - (EARLY_SHARE * period + TICK_S if ready else 0.0)

    def _next_due(self, due: Optional[rospy.Time], now: rospy.Time, period: float) -> rospy.Time:
        """Return when the cycle after the one that begins now is due: a period after this one was.

        After cycles that were missed, and where scans come more seldom than cycles, it is a period from now: so cycles
        keep in step with such scans.
        """
        step = rospy.Duration.from_sec(period)
        if due is None:
            return now + step
        late = (now - due).to_sec()
        if late > period:
            self.missed += int(late / period)
        elif late <= 0.0 or self._scan_times()[1] <= (due + step).to_sec():
            return due + step
        return now + step

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
                not self._news and (not self._requests or self._requests[0].cost > 0.0)
            ):
                self._wake.wait(seconds)
