"""A thread beside the planner's for what is slow: messages to make and send, values for the parameter server."""

from __future__ import annotations

import queue
import threading
from typing import Any, Callable

import rospy


class BackgroundThread:
    """Work that is done in order; an error is logged as `failure`, a few words, and its kind."""

    def __init__(self, name: str, failure: str) -> None:
        self._orders: "queue.Queue[Callable[[], Any]]" = queue.Queue()
        self._failure = failure
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def post(self, work: Callable[[], Any]) -> None:
        """Have something done; returns at once."""
        self._orders.put(work)

    @property
    def waiting(self) -> int:
        """Return how much waits."""
        return self._orders.qsize()

    def _run(self) -> None:
        while True:
            work = self._orders.get()
            try:
                work()
            except Exception as error:  # at a shutdown publish() raises
                if not rospy.core.is_shutdown_requested():
                    rospy.logerr_throttle(1.0, f"{self._failure}: {type(error).__name__}: {error}")
