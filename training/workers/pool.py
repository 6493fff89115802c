"""Pool of workers with the interface of concurrent.futures.

Workers that die or hang are replaced. A worker is a child process, which ends when its socket is
closed, or runs tasks on a Ray cluster (ray.py). ProcessPoolExecutor is unsuitable: if a worker
dies, all workers end; no worker can be killed; and Python 3.11 waits forever for a worker killed
while a message was in its pipe (gh-94777). pebble's pool ends if an idle worker dies.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Callable, Dict, Iterable, Iterator, Set, Tuple, TypeVar

from typing_extensions import override

from applr_ros1.common.errors import ApplrError
from training.workers.calls import CallFailed, CallLost, WorkerDied, attempt, environment
from training.workers.ray import RayWorker, connect

DEATHS_PER_CALL = 3  # number of worker deaths after which a call fails
CALL_SECONDS = 900.0  # time without an answer after which a worker counts as hung [s]
T = TypeVar("T")


class Pool(ThreadPoolExecutor):
    """Pool of workers.

    A thread of this process waits for the answers of each worker.

    Args:
        workers: Number of workers. With 0, submit() executes each call in this process, which makes
            runs repeatable.
        ray_address: HOST:PORT of a Ray cluster, "local" to start a cluster here, or "" for child
            processes.
        seconds: Time without an answer after which a worker counts as hung [s].

    Attributes:
        slots: Number of calls that can run at once.
        in_process: Whether submit() returns when the call is done.
        workers: Current workers.
        replaced: Number of workers that died or hung and were replaced.

    Raises:
        ApplrError: Ray does not answer, or an address is given without workers.
    """

    def __init__(self, workers: int, ray_address: str = "", seconds: float = CALL_SECONDS):
        if ray_address and workers == 0:
            raise ApplrError(
                f"--ray-address is {ray_address}, but there are no workers: request 1 or more"
            )
        self.slots = max(1, workers)
        self.in_process = workers == 0
        self.seconds = seconds
        super().__init__(self.slots)
        self.replaced = 0
        self._lock = threading.Lock()  # for _closed and workers
        self._closed = False
        self._start: Callable[[], Any] = ChildProcess
        self._disconnect: Callable[[], None] = lambda: None
        if ray_address:
            ray = connect(ray_address, workers)
            self._start = partial(RayWorker, ray)
            self._disconnect = ray.shutdown
        self.workers: Set[Any] = {self._start() for _ in range(workers)}
        self._free: SimpleQueue[Any] = SimpleQueue()  # workers without a call
        for worker in self.workers:
            self._free.put(worker)

    @override
    def submit(  # type: ignore[override]  # no keyword arguments
        self, function: Callable[..., Any], /, *args: Any
    ) -> Future[Any]:
        """Return a future of function(*args).

        Its exception is CallFailed.
        """
        if not self.in_process:
            return super().submit(self._call, function, args)
        future: Future[Any] = Future()
        answer = attempt(function, args)
        if isinstance(answer, CallFailed):
            future.set_exception(answer)
        else:
            future.set_result(answer)
        return future

    def unordered(
        self, function: Callable[[T], Any], items: Iterable[T]
    ) -> Iterator[Tuple[T, Future[Any]]]:
        """Yield (item, finished future of function(item)) in order of completion.

        At most `slots` calls run at once, so that a call is not made before it can start.
        """
        waiting = iter(items)
        running: Dict[Future[Any], T] = {}
        while True:
            for item in islice(waiting, self.slots - len(running)):
                running[self.submit(function, item)] = item
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future

    @override
    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the workers.

        Waiting and running calls are lost.
        """
        with self._lock:
            self._closed = True  # No worker is replaced from now on.
        for worker in self.workers:
            worker.end()
        super().shutdown(cancel_futures=True)
        self._disconnect()

    def _call(self, function: Callable[..., Any], args: Tuple[Any, ...]) -> Any:
        """Execute a call in a free worker and return its answer.

        Raise CallFailed if it fails.
        """
        for _ in range(DEATHS_PER_CALL):
            worker = self._free.get()
            try:
                answer = worker.call(function, args, self.seconds)
            except WorkerDied as death:
                # The call may have killed it, for example by running out of memory: it is repeated
                # DEATHS_PER_CALL times at most.
                worker = self._replacement(worker, death)
            else:
                if isinstance(answer, CallFailed):
                    raise answer
                return answer
            finally:
                self._free.put(worker)
        raise CallLost(f"its worker died {DEATHS_PER_CALL} times: see the messages above")

    def _replacement(self, worker: Any, death: WorkerDied) -> Any:
        """Start a worker in place of a dead one.

        Raise CallFailed if the pool is closed.
        """
        worker.end()
        with self._lock:
            if self._closed:
                raise CallLost("the pool is closed")
            print(f"worker {death}: replaced by a new one", file=sys.stderr)
            self.replaced += 1
            replacement = self._start()
            self.workers.discard(worker)
            self.workers.add(replacement)
            return replacement


class ChildProcess:
    """Single-threaded child process that executes calls one after the other, over a socket."""

    def __init__(self) -> None:
        self._connection, child_end = multiprocessing.Pipe()
        # Closed here after the start, so that the socket ends when the child dies.
        with child_end:
            descriptor = child_end.fileno()
            self.process = subprocess.Popen(
                [sys.executable, "-c", f"from {__name__} import serve; serve({descriptor})"],
                pass_fds=[descriptor],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **environment()},
                start_new_session=True,  # Only the parent process handles Ctrl-C.
            )

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Any:
        """Return the result of attempt() in the process.

        Raise WorkerDied if there is none in time.
        """
        try:
            self._connection.send((function, args))
            if self._connection.poll(seconds):
                return self._connection.recv()
        except (EOFError, OSError):
            raise WorkerDied("died") from None
        raise WorkerDied(f"gave no answer for {seconds:g} s")

    def end(self) -> None:
        """Kill the process; may be called from any thread."""
        self.process.kill()
        self.process.wait()


def serve(descriptor: int) -> None:
    """Execute calls that arrive on a socket until its other end is closed."""
    os.dup2(2, 1)  # Prints of libraries go to stderr.
    with Connection(descriptor) as connection:
        try:
            while True:
                connection.send(attempt(*connection.recv()))
        except (EOFError, ConnectionError):
            return
