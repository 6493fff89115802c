"""A pool of workers as an executor of concurrent.futures, which replaces workers that die or hang.

make_pool chooses among none (calls run in this process, the same in every run), child processes (process.py) and Ray
actors (ray.py). This is no ProcessPoolExecutor: there one death ends all workers, none can be killed, and Python 3.11
waits for ever for one that was killed while a message to it was in its pipe (gh-94777).
"""

from __future__ import annotations

import sys
import threading
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from itertools import islice
from queue import SimpleQueue
from typing import Any, Callable, Dict, Iterable, Iterator, Optional, Set, Tuple, TypeVar, Union

from applr_ros1.common.errors import ApplrError
from training.actors.process import ChildProcess, WorkerDied, attempt
from training.actors.ray import RayActor, RayCluster

GIVE_UP = 8  # workers that die one after the other without a single answer: something is wrong with all of them
TRIES = 3  # times that a call is executed before its workers' deaths count as its error
CALL_SECONDS = 900.0  # without an answer, after which a worker counts as hung
T = TypeVar("T")
Worker = Union[ChildProcess, RayActor]  # executes calls elsewhere, one after the other


class CallFailed(Exception):
    """A call ended by an error, of one line, or its workers died; the pool goes on."""


class Pool(Executor):
    """Executes each call when it is submitted, in this process.

    Attributes:
        slots: How many calls are worth submitting at once.
        in_process: Whether submit() returns when the call is done.
        alive: Workers at work.
        replaced: Workers that died or hung.
    """

    slots, in_process = 1, True
    alive = replaced = 0

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future:  # type: ignore[override]
        """A future of function(*args). Its exception is CallFailed, or ApplrError where the pool gives up."""
        future: Future = Future()
        result, error = attempt(function, args)
        if error:
            future.set_exception(CallFailed(error))
        else:
            future.set_result(result)
        return future

    def unordered(self, function: Callable[[T], Any], items: Iterable[T]) -> Iterator[Tuple[T, Future]]:
        """(item, done future of function(item)) in the order of their ends; slots at once, the next when asked for."""
        waiting = iter(items)
        running: Dict[Future, T] = {}
        while True:
            for item in islice(waiting, self.slots - len(running)):
                running[self.submit(function, item)] = item
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future


class ParallelPool(Pool):
    """Workers elsewhere, a thread for each call under way.

    Args:
        start: starts a worker.
        workers: how many.
        close: called at the end.
        seconds: without an answer, after which a worker counts as hung.
    """

    def __init__(
        self,
        start: Callable[[], Worker],
        workers: int,
        close: Callable[[], None] = lambda: None,
        seconds: float = CALL_SECONDS,
    ):
        self.slots, self.in_process, self.seconds = workers, False, seconds
        self._start, self._close = start, close
        self._threads = ThreadPoolExecutor(workers)
        self._idle: SimpleQueue[Optional[Worker]] = SimpleQueue()  # None: closed
        self._ready: Set[Worker] = set()
        self.workers: Set[Worker] = set()
        self._lock = threading.Lock()
        self._closed = False
        self._deaths = 0  # since the last answer
        for _ in range(workers):
            self._add()

    @property
    def alive(self) -> int:  # type: ignore[override]
        """Workers at work; on a Ray cluster that has lost a node others wait for a place."""
        return len(self._ready)

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future:  # type: ignore[override]
        """As Pool.submit; the next worker that is idle executes the call."""
        return self._threads.submit(self._call, function, args)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the workers; calls under way are lost."""
        with self._lock:
            self._closed = True  # from now on the set of workers stays as it is
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self.workers:
            worker.end()
        for _ in range(self.slots):
            self._idle.put(None)
        self._threads.shutdown(wait=wait)
        self._close()

    def _call(self, function: Callable[..., Any], args: Tuple[Any, ...]) -> Any:
        for _ in range(TRIES):
            worker = self._idle.get()
            if worker is None:
                break
            try:
                result, error = worker.call(function, args, self.seconds)
            except WorkerDied as death:
                self._replace(worker, str(death))
                continue
            self._deaths = 0
            self._idle.put(worker)
            if error:
                raise CallFailed(error)
            return result
        raise CallFailed("the pool is closed" if self._closed else f"its worker died {TRIES} times; see above")

    def _replace(self, worker: Worker, how: str) -> None:
        """A new worker in the place of one that ended. Raises ApplrError where the pool gives up."""
        worker.end()
        with self._lock:
            if self._closed:
                return
            self._ready.discard(worker)
            self.workers.discard(worker)
            self.replaced += 1
            self._deaths += 1
            if self._deaths >= GIVE_UP:
                raise ApplrError(
                    f"{GIVE_UP} workers {how} one after the other without an answer; see their messages above"
                )
        print(f"worker {how}; a new one takes its place", file=sys.stderr)
        self._add()

    def _add(self) -> None:
        with self._lock:
            if self._closed:
                return
            worker = self._start()
            self.workers.add(worker)

        def ready() -> None:
            if not self._closed:
                self._ready.add(worker)
                self._idle.put(worker)

        worker.when_ready(ready)


def make_pool(workers: int, ray_address: str = "", seconds: float = CALL_SECONDS) -> Pool:
    """A pool.

    Args:
        workers: how many; 0: in this process.
        ray_address: HOST:PORT of a Ray cluster, "local" for one that is started here; "": child processes.
        seconds: without an answer, after which a worker counts as hung.

    Raises:
        ApplrError: where Ray does not answer, or where an address is given that no worker would run at.
    """
    if ray_address and workers == 0:
        raise ApplrError(f"--ray-address {ray_address}: nothing would run there; it needs 1 worker or more")
    if workers == 0:
        return Pool()
    if not ray_address:
        return ParallelPool(ChildProcess, workers, seconds=seconds)
    cluster = RayCluster(ray_address, workers)
    return ParallelPool(lambda: RayActor(cluster), workers, cluster.close, seconds)
