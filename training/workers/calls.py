"""Calls of workers: how a worker executes one, how one fails, and the environment of a worker."""

from __future__ import annotations

import os
import sys
import traceback
from functools import lru_cache
from typing import Any, Callable, Dict, Tuple

# Variables that limit the threads of numpy, torch and numba: each worker has one core.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class CallFailed(Exception):
    """Failure of a call by an error or by repeated deaths of its worker.

    The pool remains usable.
    """


class CallLost(CallFailed):
    """Failure of a call because of its worker or pool: another time, it may succeed."""


class WorkerDied(Exception):
    """Worker that died, or did not answer in time; the message gives the cause."""


def environment() -> Dict[str, str]:
    """Return the environment variables of a worker: one thread, and this process's sys.path."""
    variables = dict.fromkeys(THREADS, "1")
    variables["PYTHONPATH"] = os.pathsep.join(map(os.path.abspath, sys.path))
    return variables


def attempt(function: Callable[..., Any], args: Tuple[Any, ...]) -> Any:
    """Return function(*args), or its error as a CallFailed.

    The traceback of an internal error is printed once.
    """
    try:
        return function(*args)
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        # Errors of the user or of the system, which their message explains
        if isinstance(error, (ValueError, OSError)):
            return CallFailed(line)
        _print_once(traceback.format_exc())
        return CallFailed(f"{type(error).__name__}: {line}")


@lru_cache(maxsize=None)
def _print_once(text: str) -> None:
    """Print a text once per process: hundreds of episodes may fail in the same way."""
    print(text, file=sys.stderr)
