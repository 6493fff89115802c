"""Workers that execute calls, as an executor of concurrent.futures; those that die or hang are replaced.

A worker is a child process, `python -m training.workers.pool FD`, which ends when its socket is closed, or a Ray actor
(ray.py). No ProcessPoolExecutor: there one death ends all workers, none can be killed, and Python 3.11 waits for ever
for one that was killed while a message to it was in its pipe (gh-94777).
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
import time
import traceback
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from functools import lru_cache
from itertools import islice
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Callable, Dict, Iterable, Iterator, Set, Tuple, TypeVar

from applr_ros1.common.errors import ApplrError

DEATHS_PER_CALL = 3  # after so many workers of its own have died a call ends with an error
CALL_SECONDS = 900.0  # without an answer, after which a worker counts as hung
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Answer = Tuple[Any, str]  # of a call: its result and "", or None and its error in one line
T = TypeVar("T")


class CallFailed(Exception):
    """The end of a call by an error, of one line, or by the deaths of its workers; the pool goes on."""


class WorkerDied(Exception):
    """The end of a worker, or of the time in which it had to answer; the message says which."""


class Pool(Executor):
    """Workers, each with a thread of this process that hands it one call after the other.

    Args:
        workers: How many; 0: none, and a call is executed in this process when it is submitted, the same in every run.
        ray_address: HOST:PORT of a Ray cluster, "local" for one that is started here; "": child processes.
        seconds: Without an answer, after which a worker counts as hung.

    Attributes:
        slots: How many calls are worth submitting at once.
        in_process: Whether submit() returns when the call is done.
        workers: They, and those that wait for a place on a Ray cluster that has lost a node.
        replaced: How many have died or hung.

    Raises:
        ApplrError: Ray does not answer, or an address is given that no worker would run at.
    """

    def __init__(self, workers: int, ray_address: str = "", seconds: float = CALL_SECONDS):
        if ray_address and workers == 0:
            raise ApplrError(f"--ray-address {ray_address}: nothing would run there; it needs 1 worker or more")
        self.slots, self.in_process, self.seconds = max(1, workers), workers == 0, seconds
        self.replaced = 0
        self._lock, self._closed = threading.Lock(), False
        self._calls: SimpleQueue[Any] = SimpleQueue()  # (future, function, arguments, deaths), or None: the end
        self._start: Callable[[], Any] = ChildProcess
        self._close: Callable[[], None] = lambda: None
        if ray_address:
            from training.workers.ray import RayCluster

            cluster = RayCluster(ray_address, workers)
            self._start, self._close = cluster.actor, cluster.ray.shutdown
        self.workers: Set[Any] = {self._start() for _ in range(workers)}
        self._threads = [threading.Thread(target=self._serve, args=(one,), daemon=True) for one in self.workers]
        for thread in self._threads:
            thread.start()

    @property
    def alive(self) -> int:
        """Return the number of workers that are at work."""
        with self._lock:
            return sum(worker.placed for worker in self.workers)

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future:  # type: ignore[override]
        """Return a future of function(*args), whose exception is CallFailed."""
        future: Future = Future()
        if self.in_process:
            _settle(future, *attempt(function, args))
        else:
            self._calls.put((future, function, args, 0))
        return future

    def unordered(self, function: Callable[[T], Any], items: Iterable[T]) -> Iterator[Tuple[T, Future]]:
        """Yield (item, done future of function(item)) in the order of their ends, at most `slots` under way."""
        waiting = iter(items)
        running: Dict[Future, T] = {}
        while True:
            for item in islice(waiting, self.slots - len(running)):
                running[self.submit(function, item)] = item
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the workers; calls that wait or are under way are lost."""
        with self._lock:
            self._closed = True  # from now on the set of workers stays as it is
        for worker in self.workers:
            worker.end()
            self._calls.put(None)
        for thread in self._threads:
            thread.join()
        while not self._calls.empty():
            if (call := self._calls.get()) is not None and not call[0].cancel():
                _settle(call[0], None, "the pool is closed")
        self._close()

    def _serve(self, worker: Any) -> None:
        """Hand calls to a worker, and to the one in its place where it dies, until the pool is closed."""
        while worker is not None:
            worker.wait()
            worker = self._feed(worker)

    def _feed(self, worker: Any) -> Any:
        """Hand calls to a worker until it dies. Returns the one in its place, None where the pool is closed."""
        while (call := self._calls.get()) is not None:
            future, function, args, deaths = call
            if not (deaths or future.set_running_or_notify_cancel()):
                continue
            try:
                _settle(future, *worker.call(function, args, self.seconds))
            except WorkerDied as death:
                worker.end()
                return self._replacement(worker, str(death), (future, function, args, deaths + 1))
        return None

    def _replacement(self, worker: Any, how: str, call: Tuple[Future, Callable[..., Any], Any, int]) -> Any:
        """Start a worker in the place of one that died with a call, and have another one execute the call."""
        with self._lock:
            if self._closed:
                return _settle(call[0], None, "the pool is closed")
            print(f"worker {how}; a new one takes its place", file=sys.stderr)
            self.replaced += 1
            self.workers.discard(worker)
            self.workers.add(new := self._start())
            if call[-1] < DEATHS_PER_CALL:
                self._calls.put(call)
            else:
                _settle(call[0], None, f"its worker died {call[-1]} times; see above")
            return new


class ChildProcess:
    """A child process of one thread that executes calls one after the other, and the socket to it."""

    placed = True

    def __init__(self) -> None:
        self._connection, theirs = multiprocessing.Pipe()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "training.workers.pool", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **environment()},
                start_new_session=True,  # Ctrl-C is for this process to answer
            )

    def wait(self) -> None:
        """Return when calls can be sent, which is at once."""

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Answer:
        """Return what attempt() gives there; the process is killed where that takes too long. Raises WorkerDied."""
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
        """Kill the process, from whichever thread; it holds nothing that could be lost."""
        self.process.kill()
        self.process.wait()


def environment() -> Dict[str, str]:
    """Return a worker's variables: one thread, and where this process finds this package and a person's own modules."""
    return {**dict.fromkeys(THREADS, "1"), "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}


def attempt(function: Callable[..., Any], args: Tuple[Any, ...]) -> Answer:
    """Execute a call; an error that is no mistake of a user's is also printed, once."""
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


def _settle(future: Future, result: Any, error: str) -> None:
    if error:
        future.set_exception(CallFailed(error))
    else:
        future.set_result(result)


def serve(descriptor: int) -> None:
    """Execute calls that arrive on a socket until the other end is gone."""
    os.dup2(2, 1)  # what libraries print goes to stderr
    with Connection(descriptor) as connection:
        try:
            while True:
                connection.send(attempt(*connection.recv()))
        except (EOFError, ConnectionError):
            return


if __name__ == "__main__":
    serve(int(sys.argv[1]))
