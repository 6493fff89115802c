"""The actors of Gorila: any number of workers that drive episodes, and the learner's view of them. train.py runs one.

Three ways, one interface: InProcess (--actors 0), Processes (plain child processes) and RayPool (this machine or a
cluster). Each actor asks for its next task when it has done one, and gets the newest policy with it; a thread serves
them, so neither side waits for the other. An actor that dies or hangs is replaced. What travels is bytes (worker.py):
Ray moves them as they are, and nothing that an actor sends is unpickled by our code.
"""

from __future__ import annotations

import json
import os
import queue
import socket
import struct
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

from applr_ros1.common.errors import ApplrError
from training.gorila.worker import ERROR, Worker, frame

ROOT = str(Path(__file__).resolve().parents[2])
GIVE_UP = 8  # actors that die one after the other without a single answer: something is wrong with all of them


class PoolError(ApplrError):
    """The actors cannot work; one line with what and why."""


class Pool:
    """next_task(slot) → dict is called for each new task, perhaps from another thread; `weights` come from publish."""

    actors = 0

    def __init__(self, settings: Dict[str, Any], next_task: Callable[[int], Dict[str, Any]]):
        self.settings, self.next_task = settings, next_task
        self.replaced = 0  # actors that died or hung
        self.version, self._weights = -1, b""
        self._kept = (-1, b"")
        self._lock = threading.Lock()

    def publish(self, version: int, weights: bytes) -> None:
        """The newest policy; actors get it with their next task. They wait for the first."""
        with self._lock:
            self.version, self._weights = version, weights

    def keep(self, version: int, weights: bytes) -> None:
        """A policy for evaluation tasks that name its version; replaces the one kept before."""
        with self._lock:
            self._kept = (version, weights)

    def poll(self, timeout: float) -> List[bytes]:
        """Answers that came in; waits for the first at most so long."""
        raise NotImplementedError

    @property
    def alive(self) -> int:
        return self.actors

    def close(self) -> None:
        pass

    def _task(self, slot: int, known: int) -> Tuple[Dict[str, Any], int, bytes]:
        """(task, policy version, weights if the actor knows another version)."""
        task = self.next_task(slot)
        with self._lock:
            version, weights = self._kept if task["kind"] == "evaluate" else (self.version, self._weights)
        if task.get("theta0") or "action" in task:
            return task, known, b""
        return dict(task, version=version), version, weights if version != known else b""


class InProcess(Pool):
    """No actors: poll() drives one episode here and now. What happens is the same in every run of a seed."""

    def __init__(self, settings, next_task):
        super().__init__(settings, next_task)
        self._worker, self._known = Worker(settings), -1

    def poll(self, timeout: float) -> List[bytes]:
        task, self._known, weights = self._task(0, self._known)
        return [self._worker.run(task, weights)]


class _Threaded(Pool):
    """What Processes and RayPool share: slots, a serving thread, replacement, and a bounded queue of answers."""

    def __init__(self, settings, next_task, actors: int, task_seconds: float = 900.0, waiting: Optional[int] = None):
        super().__init__(settings, next_task)
        self.actors, self.task_seconds = actors, task_seconds
        self._answers: "queue.Queue" = queue.Queue()
        self._waiting = waiting or 4 * actors + 16  # answers not yet taken, beyond which actors get no new task
        self._slots = [_Slot(i) for i in range(actors)]
        self._failed: Optional[str] = None
        self._deaths = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="actors", daemon=True)

    def _begin(self) -> None:
        for slot in self._slots:
            self._start(slot)
        self._thread.start()

    def poll(self, timeout: float) -> List[bytes]:
        if self._failed:
            raise PoolError(self._failed)
        answers = []
        try:
            answers.append(self._answers.get(timeout=timeout) if timeout > 0 else self._answers.get_nowait())
            while True:
                answers.append(self._answers.get_nowait())
        except queue.Empty:
            return answers

    @property
    def alive(self) -> int:
        return sum(slot.actor is not None for slot in self._slots)

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        for slot in self._slots:
            self._end(slot)

    def _serve(self) -> None:
        try:
            while not self._stop.is_set():
                for slot in self._slots:
                    if slot.since is None and self.version >= 0 and self._answers.qsize() < self._waiting:
                        self._give(slot)
                for slot, answer in self._collect(0.1):
                    if answer is None:
                        self._replace(slot, "died")
                    else:
                        slot.since, self._deaths = None, 0
                        self._answers.put(answer)
                now = time.monotonic()
                for slot in self._slots:
                    if slot.since is not None and now - slot.since > self.task_seconds:
                        self._replace(slot, "gave no answer for %d s" % self.task_seconds)
        except Exception as error:  # a thread must not die unheard
            self._failed = "the actor pool failed: %s: %s" % (type(error).__name__, error)

    def _give(self, slot) -> None:
        task, slot.known, weights = self._task(slot.number, slot.known)
        slot.since = time.monotonic()
        if not self._send(slot, task, weights):
            self._replace(slot, "died")

    def _replace(self, slot, why: str) -> None:
        self._end(slot)
        self.replaced += 1
        self._deaths += 1
        print("actor %d %s; a new one takes its place" % (slot.number, why), file=sys.stderr)
        if self._deaths >= GIVE_UP:
            self._failed = "%d actors %s one after the other without an answer; see their messages above" % (
                self._deaths,
                why,
            )
            self._stop.set()
            return
        self._start(slot)

    # -- for the two kinds ---------------------------------------------------------------------------
    def _start(self, slot) -> None:
        raise NotImplementedError

    def _send(self, slot, task, weights) -> bool:
        raise NotImplementedError

    def _collect(self, timeout: float) -> List[Tuple["_Slot", Optional[bytes]]]:
        """[(slot, answer, or None where the actor is dead)]"""
        raise NotImplementedError

    def _end(self, slot) -> None:
        raise NotImplementedError


class _Slot:
    """The place of one actor; the actor in it may change."""

    def __init__(self, number: int):
        self.number = number
        self.actor = None  # process, or Ray's handle
        self.link = None  # connection, or the reference of the answer awaited
        self.since = None  # when its task was given; None: it has none
        self.known = -1  # newest policy version that it has


class Processes(_Threaded):
    """Actors as child processes of this one. They end with it: a closed socket tells them."""

    def __init__(self, settings, next_task, actors, **more):
        super().__init__(settings, next_task, actors, **more)
        self._begin()

    def _start(self, slot) -> None:
        ours, theirs = socket.socketpair()
        environment = dict(
            os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1"
        )
        environment["PYTHONPATH"] = os.pathsep.join([ROOT] + [p for p in sys.path if p])
        with theirs:
            slot.actor = subprocess.Popen(
                [sys.executable, "-m", "training.gorila.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )  # Ctrl-C is for the learner to answer
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):  # half a message, then silence: a dead actor
            ours.setsockopt(socket.SOL_SOCKET, side, struct.pack("ll", 10, 0))
        slot.link, slot.known, slot.since = Connection(ours.detach()), -1, None
        slot.link.send_bytes(json.dumps(self.settings).encode())

    def _send(self, slot, task, weights) -> bool:
        try:
            slot.link.send_bytes(frame(task, weights))
            return True
        except OSError:
            return False

    def _collect(self, timeout):
        slots = {slot.link: slot for slot in self._slots if slot.since is not None}
        if not slots:
            time.sleep(timeout)
        result = []
        for link in wait(list(slots), timeout) if slots else []:
            try:
                result.append((slots[link], link.recv_bytes()))
            except (EOFError, OSError):
                result.append((slots[link], None))
        return result

    def _end(self, slot) -> None:
        if slot.actor is None:
            return
        slot.link.close()
        slot.actor.kill()  # it holds nothing that could be lost
        slot.actor.wait()
        slot.actor = slot.link = slot.since = None


class RayPool(_Threaded):
    """Actors of Ray, here or, with an address, on a cluster (whose nodes have this repo at the same path)."""

    def __init__(self, settings, next_task, actors, address: Optional[str] = None, **more):
        super().__init__(settings, next_task, actors, **more)
        self._ray = start_ray(address, actors)
        self._class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_RayActor)
        self._put = (-1, None)  # the newest weights in Ray's store
        self._begin()

    def close(self) -> None:
        super().close()
        self._ray.shutdown()

    def _start(self, slot) -> None:
        slot.actor = self._class.remote(json.dumps(self.settings).encode())
        slot.link, slot.known, slot.since = None, -1, None

    def _send(self, slot, task, weights) -> bool:
        if weights and self._put[0] != slot.known:
            self._put = (slot.known, self._ray.put(weights))
        slot.link = slot.actor.run.remote(frame(task), self._put[1] if weights else b"")
        return True

    def _collect(self, timeout):
        slots = {slot.link: slot for slot in self._slots if slot.since is not None}
        if not slots:
            time.sleep(timeout)
            return []
        ready, _ = self._ray.wait(list(slots), num_returns=1, timeout=timeout)
        if ready:
            ready, _ = self._ray.wait(list(slots), num_returns=len(slots), timeout=0)
        result = []
        for reference in ready:
            try:
                answer = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                print((str(error).splitlines() or ["Ray error"])[0], file=sys.stderr)
                answer = None
            result.append((slots[reference], answer))
        return result

    def _end(self, slot) -> None:
        if slot.actor is None:
            return
        try:  # noqa: SIM105
            self._ray.kill(slot.actor)
        except Exception:  # it is dead, or its node is
            pass
        slot.actor = slot.link = slot.since = None


class _RayActor:
    """A Worker inside Ray; bytes in, bytes out."""

    def __init__(self, settings: bytes):
        from training.gorila.worker import Worker as Here

        self.worker = Here(json.loads(settings))

    def run(self, task: bytes, weights: bytes) -> bytes:
        from training.gorila.worker import unframe

        return self.worker.run(unframe(task)[0], weights)


def start_ray(address: Optional[str], actors: int):
    """The ray module, connected. Raises PoolError with one line where Ray is missing or the address is not answered."""
    try:
        import ray
    except ImportError:
        raise PoolError("Ray is not installed; use --pool processes") from None
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    options = {
        "include_dashboard": False,
        "log_to_driver": True,
        "logging_level": "ERROR",
        "runtime_env": {"env_vars": {"PYTHONPATH": os.pathsep.join([ROOT] + [p for p in sys.path if p])}},
    }
    if address:
        _check_address(address)
        options["address"] = address
    else:
        options["num_cpus"] = actors
        options["address"] = "local"
    if not ray.is_initialized():
        try:
            ray.init(**options)
        except Exception as error:  # Ray raises many kinds
            raise PoolError(
                "Ray cannot be started%s: %s"
                % (" at %s" % address if address else "", (str(error).splitlines() or [""])[0])
            ) from None
    return ray


def _check_address(address: str, seconds: float = 5.0) -> None:
    """Whether anything listens there; Ray itself would wait for minutes."""
    if address == "auto" or address.startswith("ray://"):
        address = address[len("ray://") :] if address.startswith("ray://") else ""
    host, _, port = address.rpartition(":")
    if not address:
        return
    try:
        socket.create_connection((host or "127.0.0.1", int(port)), seconds).close()
    except (OSError, ValueError, OverflowError):
        raise PoolError(
            "no Ray answers at %s; start a head node there (ray start --head) or leave --ray-address out" % address
        ) from None


def is_error(answer: bytes) -> bool:
    return answer[:1] == ERROR
