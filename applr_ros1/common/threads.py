"""Calls that may never return, each in a thread of its own."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import Any, Callable, TypeVar

Result = TypeVar("Result")


def called(function: Callable[..., Result], *arguments: Any) -> Future[Result]:
    """Begin a call in a thread of its own, and return its future result.

    rospy's service calls have no time-out, and a process that was stopped accepts calls without
    ever answering. A pool of concurrent.futures would wait for such a call when the process ends; a
    daemon thread ends with it.
    """
    result: Future[Result] = Future()

    def run() -> None:
        try:
            result.set_result(function(*arguments))
        except Exception as problem:
            result.set_exception(problem)

    name = getattr(function, "__name__", type(function).__name__)
    threading.Thread(target=run, name=name, daemon=True).start()
    return result
