"""A pool of workers: any number of them do tasks, each asking for the next when it has done one.

make_pool chooses among none (everything happens in this process, the same in every run), child processes (local.py)
and Ray actors (ray.py). A worker that dies or hangs is replaced; a trial that it had is given again, a training episode
is not.
"""

from __future__ import annotations

import queue
import sys
import threading
from dataclasses import replace
from typing import Callable, List, Optional, Protocol, Tuple

from applr_ros1.common.errors import ApplrError
from training.actors.tasks import POLICY, Answer, Collect, Task, Trial, WorkerSettings
from training.actors.worker import Worker

GIVE_UP = 8  # workers that die one after the other without a single answer: something is wrong with all of them
RETRIES = 2  # times that a trial is given again after its worker died
TASK_SECONDS = 900.0  # without an answer, after which a worker counts as hung
IDLE = 0.05  # [s] until a worker without a task asks again
NextTask = Callable[[int], Optional[Task]]


class WorkerDied(Exception):
    """A worker gives no answer any more; the message says how it ended."""


class Link(Protocol):
    """A worker that runs elsewhere. Whoever makes a link starts the worker."""

    @property
    def has_place(self) -> bool:
        """Whether it runs; on a Ray cluster that has lost a node it may wait for a place."""

    def ask(self, task: Task, policy: bytes, seconds: float) -> Answer:
        """The answer to a task; policy: a newer one than the worker has, or b"". Raises WorkerDied."""

    def end(self) -> None:
        """End the worker, from whichever thread; what it is doing is lost."""


class Pool:
    """Workers, and the policies that they are sent. This one has none: poll() does one task here and now.

    Args:
        settings: who does which task in a worker.
        next_task: called with a worker's number for each new task, perhaps from another thread, but never twice at
            once; None: nothing to do now, ask again.
    """

    replaced = 0  # workers that died or hung

    def __init__(self, settings: WorkerSettings, next_task: NextTask):
        self.settings, self.next_task = settings, next_task
        self._newest: Tuple[int, bytes] = (-1, b"")
        self._pinned: Tuple[int, bytes] = (-1, b"")
        self._known = -1
        self._lock = threading.Lock()

    def publish(self, version: int, weights: bytes) -> None:
        """The newest policy, `version` gradient steps old; workers get it with their next training episode."""
        with self._lock:
            self._newest = (version, weights)

    def pin_for_evaluation(self, version: int, weights: bytes) -> None:
        """The policy of trials whose method is POLICY; replaces the one pinned before."""
        with self._lock:
            self._pinned = (version, weights)

    def poll(self, timeout: float) -> List[Answer]:
        """Answers that came in; waits for the first at most `timeout` seconds. Raises ApplrError."""
        if not hasattr(self, "_worker"):
            self._worker = Worker(self.settings)
        task = self.next_task(0)
        if task is None:
            return []
        task, self._known, weights = self._with_policy(task, self._known)
        return [self._worker.run(task, weights)]

    @property
    def alive(self) -> int:
        """Workers at work."""
        return 0

    def close(self) -> None:
        """End the workers; tasks under way are lost."""

    def _with_policy(self, task: Task, known: int) -> Tuple[Task, int, bytes]:
        """(task, policy version that the worker has with it, weights if it has another one now)."""
        with self._lock:
            if isinstance(task, Collect):
                version, weights = self._newest
                task = replace(task, version=version)
            elif task.method_spec == POLICY:
                version, weights = self._pinned
            else:
                return task, known, b""
        return task, version, weights if version != known else b""


class ParallelPool(Pool):
    """Workers elsewhere, each served by a thread of its own; answers wait in a bounded queue.

    Args:
        settings, next_task: as in Pool.
        workers: how many.
        start: starts a worker.
        task_seconds: without an answer, after which a worker counts as hung.
    """

    def __init__(
        self,
        settings: WorkerSettings,
        next_task: NextTask,
        workers: int,
        start: Callable[[], Link],
        task_seconds: float = TASK_SECONDS,
    ):
        super().__init__(settings, next_task)
        self._start, self.task_seconds = start, task_seconds
        self._answers: "queue.Queue[Answer]" = queue.Queue()
        self._most_waiting = 4 * workers + 16  # answers not yet taken, beyond which workers get no new task
        self._asking = threading.Lock()
        self._deaths = 0  # since the last answer
        self._failed = ""
        self._stop = threading.Event()
        self.links: List[Link] = [start() for _ in range(workers)]
        self._threads = [threading.Thread(target=self._serve, args=(i,), daemon=True) for i in range(workers)]
        for thread in self._threads:
            thread.start()

    def poll(self, timeout: float) -> List[Answer]:
        """Answers that came in; waits for the first at most `timeout` seconds. Raises ApplrError."""
        if self._failed:
            raise ApplrError(self._failed)
        answers: List[Answer] = []
        try:
            answers.append(self._answers.get(timeout=timeout) if timeout > 0 else self._answers.get_nowait())
            while True:
                answers.append(self._answers.get_nowait())
        except queue.Empty:
            return answers

    @property
    def alive(self) -> int:
        """Workers at work."""
        return sum(thread.is_alive() and link.has_place for thread, link in zip(self._threads, self.links))

    def close(self) -> None:
        """End the workers; tasks under way are lost."""
        self._stop.set()
        for link in self.links:
            link.end()
        for thread in self._threads:
            thread.join(3.0)

    def _serve(self, number: int) -> None:
        """One worker's thread."""
        known = -1  # version of the policy that the worker has
        try:
            while not self._stop.is_set():
                with self._asking:
                    full = self._answers.qsize() >= self._most_waiting
                    task = None if full else self.next_task(number)
                if task is None:
                    self._stop.wait(IDLE)
                    continue
                for _ in range(1 + RETRIES * isinstance(task, Trial)):
                    task, known, weights = self._with_policy(task, known)
                    try:
                        answer = self.links[number].ask(task, weights, self.task_seconds)
                    except WorkerDied as death:
                        known = -1
                        if not self._replace(number, str(death)):
                            return
                    else:
                        self._deaths = 0
                        self._answers.put(answer)
                        break
                else:
                    if isinstance(task, Trial):
                        text = f"its worker died {1 + RETRIES} times; see the messages above"
                        self._answers.put(Answer(task, text))
        except Exception as error:  # a thread must not die unheard
            self._failed = f"the pool of workers failed: {type(error).__name__}: {error}"

    def _replace(self, number: int, how: str) -> bool:
        """A new worker in the place of one that ended; False where the pool is closed or gives up."""
        if self._stop.is_set():
            return False
        self.links[number].end()
        print(f"worker {number} {how}; a new one takes its place", file=sys.stderr)
        with self._asking:
            self.replaced += 1
            self._deaths += 1
            if self._deaths >= GIVE_UP:
                self._failed = (
                    f"{GIVE_UP} workers {how} one after the other without an answer; see their messages above"
                )
                self._stop.set()
                return False
        self.links[number] = self._start()
        if self._stop.is_set():  # closed meanwhile
            self.links[number].end()
        return True


def make_pool(
    settings: WorkerSettings,
    next_task: NextTask,
    workers: int,
    ray_address: str = "",
    task_seconds: float = TASK_SECONDS,
) -> Pool:
    """A pool.

    Args:
        settings: who does which task in a worker.
        next_task: as in Pool.
        workers: how many; 0: in this process.
        ray_address: HOST:PORT of a Ray cluster, "local" for one that is started here; "": child processes.
        task_seconds: without an answer, after which a worker counts as hung.

    Raises:
        ApplrError: where Ray does not answer, or where an address is given that no worker would run at.
    """
    if ray_address and workers == 0:
        raise ApplrError(f"--ray-address {ray_address}: nothing would run there; it needs 1 worker or more")
    if workers == 0:
        return Pool(settings, next_task)
    from training.actors import local, ray

    if ray_address:
        return ray.RayPool(settings, next_task, workers, ray_address, task_seconds)
    return ParallelPool(settings, next_task, workers, lambda: local.ChildProcess(settings), task_seconds)
