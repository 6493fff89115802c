"""Progress messages for long computations."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Callable, Iterator

FIRST_LINE_S = 2.0  # time after which the work is announced [s]
NEXT_LINE_S = 10.0  # interval between progress lines [s]


@contextlib.contextmanager
def announced(
    work: str,
    report: Callable[[str], object],
    first: float = FIRST_LINE_S,
    every: float = NEXT_LINE_S,
) -> Iterator[None]:
    """Report the work of a block if it takes longer than `first`, and its duration at the end.

    Args:
        work: Description with the expected duration, such as "compiling kernels (about a minute the
            first time)".
        report: Called with each line, from another thread.
        first: Time before the first line [s].
        every: Interval between further lines [s].
    """
    work_name = work.split(" (")[0]
    start_time = time.monotonic()
    has_ended = threading.Event()
    is_announced = False

    def repeat() -> None:
        nonlocal is_announced
        if has_ended.wait(first):
            return
        report(work)
        is_announced = True
        while not has_ended.wait(every):
            report(f"still {work_name}: {round(time.monotonic() - start_time)} s")

    reporter = threading.Thread(target=repeat, name="progress", daemon=True)
    reporter.start()
    try:
        yield
    except BaseException:
        is_announced = False  # "done" would be wrong about work that failed.
        raise
    finally:
        has_ended.set()
        reporter.join()
        if is_announced:
            report(f"done {work_name}: took {time.monotonic() - start_time:.0f} s")
