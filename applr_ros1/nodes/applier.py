"""The applr node's worker: brings wanted parameters to the planner, and tries again until they are there.

The node calls `want` from its own thread and never waits. A newer wish replaces an older one.
"""

import threading
import time

import numpy as np

RETRY = 0.25  # s between attempts
REFUSALS = 3  # attempts at a set that a server refuses; the next decision is another set
PATIENCE = 5  # failed looks for the servers, a second apart, before it is said: both start at the same time
SETTLE = 1.0  # s after which an abandoned call can no longer come through unseen


class Applier:
    """Applies theta with a client (ReconfigureClient) in a thread of its own.

    on_report(report): called after every attempt; on_trouble(line): while the servers cannot be found. Both from
    the worker's thread. Wall time throughout: the planner answers in that, whatever the clock of ROS does.
    """

    def __init__(self, client, on_report, on_trouble):
        self.client, self._on_report, self._on_trouble = client, on_report, on_trouble
        self.applied = None  # theta of the last success
        self._wanted = None  # theta still to be brought
        self._serial = 0  # counts the wishes
        self._refusals = 0
        self._abandoned = None  # theta of a call whose end is not known
        self._check_at = None
        self._stopped = False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="applier", daemon=True)

    def start(self):
        self._thread.start()

    def want(self, theta):
        """theta (8,) finite: to be applied as soon as possible, instead of what was wanted before."""
        with self._condition:
            self._wanted = np.array(theta, dtype=np.float64)
            self._serial += 1
            self._refusals = 0
            self._condition.notify_all()

    def again(self):
        """Applies the current parameters anew: a server came back and has its start-up values."""
        with self._condition:
            if self._wanted is None and self.applied is not None:
                self._wanted = self.applied
                self._refusals = 0
                self._condition.notify_all()

    def stop(self):
        with self._condition:
            self._stopped = True
            self._condition.notify_all()
        self._thread.join(3.0)

    @property
    def busy(self):
        return self._wanted is not None

    def idle(self, seconds):
        """Waits until nothing is left to do; False when `seconds` pass before."""
        with self._condition:
            return self._condition.wait_for(lambda: self._wanted is None and self._check_at is None, seconds)

    def _run(self):
        missed = 0
        while not self._stopped:
            try:
                if self.client.connected:
                    self._turn()
                else:
                    trouble = self.client.connect()
                    missed += bool(trouble)
                    if trouble:
                        if missed >= PATIENCE:
                            self._on_trouble(trouble)
                        self._pause(4 * RETRY)
            except Exception as e:  # whatever it is, the thread that talks to the planner stays
                self._on_trouble(f"parameters not applied ({type(e).__name__}: {e})")
                self._pause(4 * RETRY)

    def _turn(self):
        with self._condition:
            self._condition.wait_for(
                lambda: self._stopped or self._wanted is not None or self._check_due(),
                None if self._check_at is None else SETTLE,
            )
            theta, serial, stopped = self._wanted, self._serial, self._stopped
        if stopped:
            return
        if theta is not None:
            self._attempt(theta, serial)
        elif self._check_due():
            self._settle()

    def _attempt(self, theta, serial):
        report = self.client.apply(theta)
        with self._condition:
            newer = serial != self._serial
            if report.ok:
                self.applied = theta
                if self._abandoned is not None:
                    self._check_at = time.monotonic() + SETTLE
            elif report.uncertain:
                self._abandoned = theta
            elif report.put_back:
                self._refusals += 1
            if not newer and (report.ok or self._refusals >= REFUSALS):
                self._wanted = None
                self._condition.notify_all()
            waiting = self._wanted is not None and not newer
        self._on_report(report)
        if waiting:
            self._pause(RETRY)

    def _check_due(self):
        return self._check_at is not None and time.monotonic() >= self._check_at

    def _settle(self):
        """An abandoned call may have come through after the newer one: then the newer one is applied again."""
        with self._condition:
            late = self._abandoned
            self._abandoned = self._check_at = None
            self._condition.notify_all()
        if late is not None and not np.array_equal(late, self.applied) and np.array_equal(late, self.client.theta()):
            self.again()

    def _pause(self, seconds):
        """Waits, though not for a stop or a newer wish."""
        with self._condition:
            serial = self._serial
            self._condition.wait_for(lambda: self._stopped or self._serial != serial, seconds)
