"""Progress lines about work that takes long."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Callable, Iterator

FIRST_LINE_S = 2.0  # time after which the work is announced [s]
NEXT_LINE_S = 10.0  # interval between progress lines [s]


@contextlib.contextmanager
def announced(
    what: str, say: Callable[[str], object], first: float = FIRST_LINE_S, every: float = NEXT_LINE_S
) -> Iterator[None]:
    """Report work while it runs, if it takes longer than `first`, and its duration at the end.

    Args:
        what: Description with the expected duration, such as "compiling kernels (about a minute the first time)".
        say: Called with each line, from another thread.
        first: Time before the first line [s].
        every: Interval between further lines [s].
    """
    short, began, done, spoken = what.split(" (")[0], time.monotonic(), threading.Event(), False

    def speak() -> None:
        nonlocal spoken
        while not done.wait(every if spoken else first):
            say(f"still {short}: {round(time.monotonic() - began)} s" if spoken else what)
            spoken = True

    speaker = threading.Thread(target=speak, name="progress", daemon=True)
    speaker.start()
    try:
        yield
    except BaseException:
        spoken = False
        raise
    finally:
        done.set()
        speaker.join()
        if spoken:
            say(f"done {short}: took {time.monotonic() - began:.0f} s")
