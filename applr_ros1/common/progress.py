"""Lines about long work: it is announced, and repeated until it is done."""

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
