"""Workers that execute calls, as an executor of concurrent.futures; those that die or hang are replaced.

A worker is a child process, which ends when its socket is closed, or runs tasks on a Ray cluster (ray.py). No
ProcessPoolExecutor: there one death ends all workers, none can be killed, and Python 3.11 waits for ever for one that
was killed while a message to it was in its pipe (gh-94777). pebble's pool ends with a worker that dies without a call.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
import traceback
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import lru_cache, partial
from itertools import islice
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Callable, Dict, Iterable, Iterator, Set, Tuple, TypeVar

from applr_ros1.common.errors import ApplrError

DEATHS_PER_CALL = 3  # number of workers that may die of one call
CALL_SECONDS = 900.0  # time without an answer after which a worker counts as hung [s]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
T = TypeVar("T")


class CallFailed(Exception):
    """The end of a call by an error, of one line, or by the deaths of its workers; the pool goes on."""


class WorkerDied(Exception):
    """The end of a worker, or of the time in which it had to answer; the message says which."""


class Pool(ThreadPoolExecutor):
    """Workers, and as many threads of this process, which wait for their answers.

    Args:
        workers: How many; 0: none, and a call is executed in this process when it is submitted, the same in every run.
        ray_address: HOST:PORT of a Ray cluster, "local" for one that is started here; "": child processes.
        seconds: Time without an answer after which a worker counts as hung.

    Attributes:
        slots: How many calls are worth submitting at once.
        in_process: Whether submit() returns when the call is done.
        workers: The workers.
        replaced: How many have died or hung.

    Raises:
        ApplrError: Ray does not answer, or an address is given that no worker would run at.
    """

    def __init__(self, workers: int, ray_address: str = "", seconds: float = CALL_SECONDS):
        if ray_address and workers == 0:
            raise ApplrError(f"--ray-address {ray_address}: nothing would run there; it needs 1 worker or more")
        self.slots, self.in_process, self.seconds = max(1, workers), workers == 0, seconds
        super().__init__(self.slots)
        self.alive, self.replaced = workers, 0
        self._lock, self._closed = threading.Lock(), False
        self._start: Callable[[], Any] = ChildProcess
        self._disconnect: Callable[[], None] = lambda: None
        if ray_address:
            from training.workers.ray import RayWorker, connect

            ray = connect(ray_address, workers)
            self._start, self._disconnect = partial(RayWorker, ray), ray.shutdown
        self.workers: Set[Any] = {self._start() for _ in range(workers)}
        self._free: SimpleQueue[Any] = SimpleQueue()
        for worker in self.workers:
            self._free.put(worker)

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future:  # type: ignore[override]
        """Return a future of function(*args), whose exception is CallFailed."""
        if not self.in_process:
            return super().submit(self._call, function, args)
        future: Future = Future()
        answer = attempt(function, args)
        if isinstance(answer, CallFailed):
            future.set_exception(answer)
        else:
            future.set_result(answer)
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
        super().shutdown(cancel_futures=True)
        self._disconnect()

    def _call(self, function: Callable[..., Any], args: Tuple[Any, ...]) -> Any:
        """Return the answer of a free worker. Raises CallFailed."""
        for _ in range(DEATHS_PER_CALL):
            worker = self._free.get()
            try:
                answer = worker.call(function, args, self.seconds)
            except WorkerDied as death:
                worker = self._replacement(worker, death)
            else:
                if isinstance(answer, CallFailed):
                    raise answer
                return answer
            finally:
                self._free.put(worker)
        raise CallFailed(f"its worker died {DEATHS_PER_CALL} times; see above")

    def _replacement(self, worker: Any, death: WorkerDied) -> Any:
        """Start a worker in the place of a dead one. Raises CallFailed if the pool is closed."""
        worker.end()
        with self._lock:
            if self._closed:
                raise CallFailed("the pool is closed")
            print(f"worker {death}; a new one takes its place", file=sys.stderr)
            self.replaced += 1
            self.workers.discard(worker)
            self.workers.add(new := self._start())
            return new


class ChildProcess:
    """A child process of one thread that executes calls one after the other, and the socket to it."""

    def __init__(self) -> None:
        self._connection, theirs = multiprocessing.Pipe()
        with theirs:
            code = f"from {__name__} import serve; serve({theirs.fileno()})"
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **environment()},
                start_new_session=True,  # Ctrl-C is for this process to answer
            )

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Any:
        """Return what attempt() gives there. Raises WorkerDied."""
        try:
            self._connection.send((function, args))
            if self._connection.poll(seconds):
                return self._connection.recv()
        except (EOFError, OSError):
            raise WorkerDied("died") from None
        raise WorkerDied(f"gave no answer for {seconds:g} s")

    def end(self) -> None:
        """Kill the process, from whichever thread; it holds nothing that could be lost."""
        self.process.kill()
        self.process.wait()


def environment() -> Dict[str, str]:
    """Return a worker's variables: one thread, and where this process finds this package and a person's own modules."""
    return {**dict.fromkeys(THREADS, "1"), "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}


def attempt(function: Callable[..., Any], args: Tuple[Any, ...]) -> Any:
    """Return function(*args), or its error as a CallFailed; an error that is no mistake of a user's is printed once."""
    try:
        return function(*args)
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        if isinstance(error, (ValueError, OSError)):
            return CallFailed(line)
        _print_once(traceback.format_exc())
        return CallFailed(f"{type(error).__name__}: {line}")


@lru_cache(maxsize=None)
def _print_once(text: str) -> None:
    print(text, file=sys.stderr)


def serve(descriptor: int) -> None:
    """Execute calls that arrive on a socket until the other end is gone."""
    os.dup2(2, 1)  # what libraries print goes to stderr
    with Connection(descriptor) as connection:
        try:
            while True:
                connection.send(attempt(*connection.recv()))
        except (EOFError, ConnectionError):
            return
