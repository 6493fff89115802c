"""A pool of workers: any number of them do tasks, each asking for the next when it has done one.

Three kinds, one interface: InProcess (none: everything happens here, the same in every run), ChildProcesses (local.py)
and RayActors (ray.py). make_pool chooses. A worker that dies or hangs is replaced; a trial that it had is given again,
a training episode is not.
"""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Any, Callable, Deque, Dict, List, Optional, Tuple

from applr_ros1.common.errors import ApplrError
from training.workers.tasks import (
    POLICY,
    Answer,
    Collect,
    MessageError,
    Task,
    Trial,
    WorkerSettings,
    decode_answer,
)
from training.workers.worker import Worker

KINDS = ("ray", "processes")  # of parallel workers
GIVE_UP = 8  # workers that die one after the other without a single answer: something is wrong with all of them
RETRIES = 2  # times that a trial is given again after its worker died
TASK_SECONDS = 900.0  # without an answer, after which a worker counts as hung
NextTask = Callable[[int], Optional[Task]]


class PoolError(ApplrError):
    """The workers cannot work; one line with what and why."""


class Pool:
    """Workers, and the policies that they are sent.

    Args:
        settings: who does which task in a worker.
        next_task: called with a worker's number for each new task, perhaps from another thread; None: nothing to do
            now, ask again.
    """

    workers = 0

    def __init__(self, settings: WorkerSettings, next_task: NextTask):
        self.settings, self.next_task = settings, next_task
        self.replaced = 0  # workers that died or hung
        self._newest: Tuple[int, bytes] = (-1, b"")
        self._pinned: Tuple[int, bytes] = (-1, b"")
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
        """Answers that came in; waits for the first at most `timeout` seconds. Raises PoolError."""
        raise NotImplementedError

    @property
    def alive(self) -> int:
        """Workers at work."""
        return self.workers

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


class InProcess(Pool):
    """No workers: poll() does one task here and now. What happens is the same in every run of a seed."""

    def __init__(self, settings: WorkerSettings, next_task: NextTask):
        super().__init__(settings, next_task)
        self._worker, self._known = Worker(settings), -1

    def poll(self, timeout: float) -> List[Answer]:
        """Does the next task, if there is one."""
        task = self.next_task(0)
        if task is None:
            return []
        task, self._known, weights = self._with_policy(task, self._known)
        return [self._worker.run(task, weights)]


class Slot:
    """The place of one worker; the worker in it may change."""

    def __init__(self, number: int):
        self.number = number
        self.worker: Any = None  # a process, or Ray's handle
        self.link: Any = None  # a connection, or the reference of the answer awaited
        self.known = -1  # version of the policy that the worker has
        self.task: Optional[Task] = None
        self.since = 0.0  # when the task was given


class ParallelPool(Pool):
    """What child processes and Ray actors share: slots, a serving thread, replacement, a bounded queue of answers."""

    def __init__(self, settings: WorkerSettings, next_task: NextTask, workers: int, task_seconds: float = TASK_SECONDS):
        super().__init__(settings, next_task)
        self.workers, self.task_seconds = workers, task_seconds
        self.slots = [Slot(i) for i in range(workers)]
        self._answers: "queue.Queue[Answer]" = queue.Queue()
        self._most_waiting = 4 * workers + 16  # answers not yet taken, beyond which workers get no new task
        self._again: Deque[Trial] = deque()  # trials whose workers died
        self._ended: Dict[Trial, int] = {}  # how many workers a trial has ended
        self._deaths = 0  # since the last answer
        self._failed: Optional[str] = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="workers", daemon=True)

    def _begin(self) -> None:
        for slot in self.slots:
            self._start(slot)
        self._thread.start()

    def poll(self, timeout: float) -> List[Answer]:
        """Answers that came in; waits for the first at most `timeout` seconds. Raises PoolError."""
        if self._failed:
            raise PoolError(self._failed)
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
        return sum(slot.worker is not None for slot in self.slots)

    def close(self) -> None:
        """End the workers; tasks under way are lost."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        for slot in self.slots:
            self._end(slot)

    def _serve(self) -> None:
        try:
            while not self._stop.is_set():
                for slot in self.slots:
                    if slot.task is None and self._answers.qsize() < self._most_waiting and not self._give(slot):
                        break
                for slot, message in self._collect([slot for slot in self.slots if slot.task is not None], 0.1):
                    if message is None:
                        self._replace(slot, "died")
                    else:
                        self._take(slot, message)
                now = time.monotonic()
                for slot in self.slots:
                    if slot.task is not None and now - slot.since > self.task_seconds:
                        self._replace(slot, "gave no answer for %d s" % self.task_seconds)
        except Exception as error:  # a thread must not die unheard
            self._failed = "the pool of workers failed: %s: %s" % (type(error).__name__, error)

    def _give(self, slot: Slot) -> bool:
        """Whether there was a task for the slot's worker."""
        task = self._again.popleft() if self._again else self.next_task(slot.number)
        if task is None:
            return False
        slot.task, slot.known, weights = self._with_policy(task, slot.known)
        slot.since = time.monotonic()
        if not self._send(slot, slot.task, weights):
            self._replace(slot, "died")
        return True

    def _take(self, slot: Slot, message: bytes) -> None:
        task, slot.task, self._deaths = slot.task, None, 0
        assert task is not None
        try:
            self._answers.put(decode_answer(message, task))
        except MessageError as error:
            self._answers.put(Answer(task, "a worker's answer is malformed: %s" % error))

    def _replace(self, slot: Slot, why: str) -> None:
        task, slot.task = slot.task, None
        self._end(slot)
        self.replaced += 1
        self._deaths += 1
        print("worker %d %s; a new one takes its place" % (slot.number, why), file=sys.stderr)
        if self._deaths >= GIVE_UP:
            self._failed = "%d workers %s one after the other without an answer; see their messages above" % (
                self._deaths,
                why,
            )
            self._stop.set()
            return
        if isinstance(task, Trial):
            self._ended[task] = self._ended.get(task, 0) + 1
            if self._ended[task] <= RETRIES:
                self._again.append(task)
            else:
                text = "it ended its worker %d times; see the messages above" % self._ended.pop(task)
                self._answers.put(Answer(task, text))
        self._start(slot)

    # -- for the two kinds ---------------------------------------------------------------------------
    def _start(self, slot: Slot) -> None:
        raise NotImplementedError

    def _send(self, slot: Slot, task: Task, weights: bytes) -> bool:
        raise NotImplementedError

    def _collect(self, busy: List[Slot], timeout: float) -> List[Tuple[Slot, Optional[bytes]]]:
        """[(slot, answer, or None where the worker is dead)]; sleeps for the timeout where no slot is busy."""
        raise NotImplementedError

    def _end(self, slot: Slot) -> None:
        raise NotImplementedError


def make_pool(
    settings: WorkerSettings, next_task: NextTask, workers: int, kind: str = "processes", address: str = ""
) -> Pool:
    """A pool.

    Args:
        settings: who does which task in a worker.
        next_task: as in Pool.
        workers: how many; 0: in this process.
        kind: one of KINDS.
        address: HOST:PORT of a Ray cluster; "" starts Ray on this machine.

    Raises:
        PoolError: where Ray is missing or does not answer, or where an address is given that no worker would run at.
    """
    if address and (workers == 0 or kind != "ray"):
        raise PoolError(
            "--ray-address %s: nothing would run there; it needs --pool ray and 1 worker or more, or leave it out"
            % address
        )
    from training.workers.local import ChildProcesses
    from training.workers.ray import RayActors

    if workers == 0:
        return InProcess(settings, next_task)
    if kind == "ray":
        return RayActors(settings, next_task, workers, address)
    return ChildProcesses(settings, next_task, workers)
