"""Lines about what a program does: long work is announced, repeated lines are throttled. The nodes use both."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Callable, Iterator

FIRST_LINE_S = 2.0  # s after which the work is announced
NEXT_LINE_S = 10.0  # s between further lines


@contextlib.contextmanager
def announced(
    what: str, say: Callable[[str], object], first: float = FIRST_LINE_S, every: float = NEXT_LINE_S
) -> Iterator[None]:
    """Say what work is going on once it takes long, and at its end how long it took.

    Args:
        what: The work, with how long it may take, such as "compiling kernels (about a minute the first time)".
        say: Called with each line, from another thread.
        first: Time [s] after which the first line comes.
        every: Time [s] between further lines.
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


class Throttled:
    """A filter of a repeated line: one in NEXT_LINE_S of wall time passes, with how often it has come so far."""

    def __init__(self, say: Callable[[str], object]):
        self._say, self._count, self._due = say, 0, 0.0

    def __call__(self, line: str) -> None:
        """Count the line, and pass it on if the last one that was passed on is long ago."""
        self._count += 1
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + NEXT_LINE_S
            self._say(line if self._count == 1 else f"{line} ({self._count} times so far)")
