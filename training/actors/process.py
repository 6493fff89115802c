"""A worker as a child process, `python -m training.actors.process FD`, which ends when its socket is closed."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
import time
import traceback
from functools import lru_cache
from multiprocessing.connection import Connection
from typing import Any, Callable, Dict, Tuple

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerDied(Exception):
    """A worker gives no answer any more; the message says how it ended."""


class ChildProcess:
    """A child process of one thread that executes calls one after the other, and the socket to it."""

    def __init__(self) -> None:
        self._connection, theirs = multiprocessing.Pipe()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "training.actors.process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **environment()},
                start_new_session=True,  # Ctrl-C is for this process to answer
            )

    def when_ready(self, callback: Callable[[], None]) -> None:
        """Calls back when calls can be sent, which is at once."""
        callback()

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Tuple[Any, str]:
        """What attempt() gives there; the process is killed where that takes too long. Raises WorkerDied."""
        until = time.monotonic() + seconds
        deadline = threading.Timer(seconds, self.process.kill)
        deadline.start()
        try:
            self._connection.send((function, args))
            return self._connection.recv()
        except (EOFError, OSError):
            late = time.monotonic() >= until
            raise WorkerDied(f"gave no answer for {seconds:g} s" if late else "died") from None
        finally:
            deadline.cancel()

    def end(self) -> None:
        """End the process, from whichever thread; it holds nothing that could be lost."""
        self.process.kill()
        self.process.wait()


def environment() -> Dict[str, str]:
    """Variables of a worker's process: one thread, and where this one finds this package and a person's own modules."""
    return {**dict.fromkeys(THREADS, "1"), "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}


def attempt(function: Callable[..., Any], args: Tuple[Any, ...]) -> Tuple[Any, str]:
    """(result, "") of a call, or (None, its error in one line). What is no user's mistake is also printed, once."""
    try:
        return function(*args), ""
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        if isinstance(error, (ValueError, OSError)):
            return None, line
        _print_once(traceback.format_exc())
        return None, f"{type(error).__name__}: {line}"


@lru_cache(maxsize=None)
def _print_once(text: str) -> None:
    print(text, file=sys.stderr)


def serve(descriptor: int) -> None:
    """Executes calls that arrive on a socket until the other end is gone."""
    os.dup2(2, 1)  # what libraries print goes to stderr
    with Connection(descriptor) as connection:
        try:
            while True:
                connection.send(attempt(*connection.recv()))
        except (EOFError, ConnectionError):
            return


if __name__ == "__main__":
    serve(int(sys.argv[1]))
