"""The applr node's worker thread: brings requested parameters to the planner, and tries again until they are in force.

The node calls `request` from its own thread and never waits. A newer request replaces an older one.
"""

from __future__ import annotations

import threading
from typing import Callable, Optional

import numpy as np

from applr_ros1.nodes.applr.reconfigure_client import DEADLINE, ApplyReport, ReconfigureClient

RETRY = 0.25  # s between attempts
REFUSALS = 3  # attempts at a set that a server refuses; the next decision brings another set
PATIENCE = 15  # failed searches for the servers, a second apart, before they are reported; none while move_base starts


class ReconfigureWorker:
    """Applies theta with a client in a thread of its own. Deadlines are wall time, whatever the clock of ROS does.

    Args:
        client: Reaches the planner's reconfigure servers.
        on_report: Called with the ApplyReport of every attempt, from the worker's thread.
        on_trouble: Called with one line while the servers cannot be found, and with "" when they have been found, from
            the worker's thread.
    """

    def __init__(
        self,
        client: ReconfigureClient,
        on_report: Callable[[ApplyReport], None],
        on_trouble: Callable[[str], None],
    ):
        self.client, self._on_report, self._on_trouble = client, on_report, on_trouble
        self.applied: Optional[np.ndarray] = None  # theta (n,) of the last success
        self._requested: Optional[np.ndarray] = None  # theta (n,) that is not in force yet
        self._serial = 0  # counts the requests
        self._refusals = 0
        self._stopped = False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="reconfigure_worker", daemon=True)

    def start(self) -> None:
        """Begin to work; requests made before are kept."""
        self._thread.start()

    def request(self, theta: np.ndarray) -> None:
        """Have theta (n,), finite, applied as soon as possible, instead of what was requested before."""
        with self._condition:
            self._requested = np.array(theta, dtype=np.float64)
            self._serial += 1
            self._refusals = 0
            self._condition.notify_all()

    def reapply(self) -> None:
        """Apply the present parameters anew: a server came back and has its start-up values."""
        with self._condition:
            if self._requested is None:
                self._requested = self.applied
            self._serial += 1  # an attempt that is under way may have reached the server before
            self._refusals = 0
            self._condition.notify_all()

    def stop(self) -> None:
        """End the thread; what is still requested is dropped."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()
        self._thread.join(2 * DEADLINE + 0.1)  # an attempt that is under way takes no longer

    @property
    def busy(self) -> bool:
        """Whether a request is not in force yet."""
        return self._requested is not None

    def _run(self) -> None:
        failures = 0
        while not self._stopped:
            try:
                if self.client.connected:
                    self._work()
                    continue
                trouble = self.client.connect()
                failures = 0 if self.client.starting else failures + 1
                if not trouble:
                    self._on_trouble("")
                    continue
                if failures >= PATIENCE:
                    self._on_trouble(trouble)
            except Exception as e:  # whatever it is, the thread that talks to the planner goes on
                self._on_trouble(f"parameters not applied ({type(e).__name__}: {e})")
            self._pause(4 * RETRY)

    def _work(self) -> None:
        """Wait for a request, and make one attempt at it."""
        with self._condition:
            self._condition.wait_for(lambda: self._stopped or self._requested is not None)
            theta, serial, stopped = self._requested, self._serial, self._stopped
        if stopped or theta is None:
            return
        report = self.client.apply(theta)
        with self._condition:
            newer = serial != self._serial
            if report.ok:
                self.applied = theta
            elif report.refused and not report.unanswered:
                self._refusals += 1
            if not newer and (report.ok or self._refusals >= REFUSALS):
                self._requested = None
            waiting = self._requested is not None and not newer
        self._on_report(report)
        if waiting:
            self._pause(RETRY)

    def _pause(self, seconds: float) -> None:
        """Wait for `seconds`, or until the worker is stopped or gets a newer request."""
        with self._condition:
            serial = self._serial
            self._condition.wait_for(lambda: self._stopped or self._serial != serial, seconds)
