"""Workers as Ray actors, here or on a cluster whose nodes have this repository at the same path.

Ray moves bytes as they are: nothing that a worker sends is unpickled by our code.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from typing import Any, Dict, List, Optional, Tuple

from training.workers.local import environment
from training.workers.pool import TASK_SECONDS, NextTask, ParallelPool, PoolError, Slot
from training.workers.tasks import (
    Task,
    WorkerSettings,
    decode_settings,
    decode_task,
    encode_answer,
    encode_settings,
    encode_task,
)


class RayActors(ParallelPool):
    """`workers` actors of Ray at `address`, or, with "", of a Ray that is started on this machine."""

    def __init__(
        self,
        settings: WorkerSettings,
        next_task: NextTask,
        workers: int,
        address: str = "",
        task_seconds: float = TASK_SECONDS,
    ):
        super().__init__(settings, next_task, workers, task_seconds)
        self._ray = start_ray(address, workers)
        self._class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_RayWorker)
        self._put: Tuple[int, Any] = (-1, None)  # version and reference of the newest weights in Ray's store
        self._begin()

    def close(self) -> None:
        """End the actors and leave Ray."""
        super().close()
        self._ray.shutdown()

    def _start(self, slot: Slot) -> None:
        slot.worker = self._class.remote(encode_settings(self.settings))
        slot.link, slot.known = None, -1

    def _send(self, slot: Slot, task: Task, weights: bytes) -> bool:
        if weights and self._put[0] != slot.known:
            self._put = (slot.known, self._ray.put(weights))
        slot.link = slot.worker.run.remote(encode_task(task), self._put[1] if weights else b"")
        return True

    def _collect(self, busy: List[Slot], timeout: float) -> List[Tuple[Slot, Optional[bytes]]]:
        slots = {slot.link: slot for slot in busy}
        if not slots:
            time.sleep(timeout)
            return []
        ready, _ = self._ray.wait(list(slots), num_returns=1, timeout=timeout)
        if ready:
            ready, _ = self._ray.wait(list(slots), num_returns=len(slots), timeout=0)
        found: List[Tuple[Slot, Optional[bytes]]] = []
        for reference in ready:
            try:
                found.append((slots[reference], self._ray.get(reference)))
            except self._ray.exceptions.RayError as error:
                print((str(error).splitlines() or ["Ray error"])[0], file=sys.stderr)
                found.append((slots[reference], None))
        return found

    def _end(self, slot: Slot) -> None:
        if slot.worker is None:
            return
        try:
            self._ray.kill(slot.worker)
        except Exception as error:  # it is dead, or its node is; Ray raises many kinds
            print("Ray: %s" % (str(error).splitlines() or [type(error).__name__])[0], file=sys.stderr)
        slot.worker = slot.link = None


class _RayWorker:
    """A Worker inside Ray; bytes in, bytes out."""

    def __init__(self, settings: bytes):
        from training.workers.worker import Worker

        self.worker = Worker(decode_settings(settings))

    def run(self, message: bytes, weights: bytes) -> bytes:
        return encode_answer(self.worker.run(decode_task(message)[0], weights))


def start_ray(address: str, workers: int) -> Any:
    """The ray module, connected. Raises PoolError with one line where Ray is missing or nothing answers there.

    A Ray that is started here listens on the loopback interface only, and has no dashboard.
    """
    if not address:
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # read when ray is imported: no cluster, so no other host
    try:
        import ray
    except ImportError:
        raise PoolError("Ray is not installed; use --pool processes") from None
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    options: Dict[str, Any] = {
        "include_dashboard": False,
        "log_to_driver": True,
        "logging_level": "ERROR",
        "runtime_env": {"env_vars": environment()},
        "address": address or "local",
    }
    if address:
        _check_address(address)
    else:
        options.update(num_cpus=workers, _node_ip_address="127.0.0.1")
    if not ray.is_initialized():
        try:
            ray.init(**options)
        except Exception as error:  # Ray raises many kinds
            where = " at %s" % address if address else ""
            raise PoolError("Ray cannot be started%s: %s" % (where, (str(error).splitlines() or [""])[0])) from None
    if address and os.environ.get("RAY_AUTH_MODE") != "token":
        print("Ray at %s takes work from anybody who reaches it: set RAY_AUTH_MODE=token" % address, file=sys.stderr)
    return ray


def _check_address(address: str, seconds: float = 5.0) -> None:
    """Whether anything listens there; Ray itself would wait for minutes."""
    if address == "auto":
        return
    host, _, port = (address[len("ray://") :] if address.startswith("ray://") else address).rpartition(":")
    try:
        socket.create_connection((host or "127.0.0.1", int(port)), seconds).close()
    except (OSError, ValueError, OverflowError):
        raise PoolError(
            "no Ray answers at %s; start a head node there (ray start --head) or leave --ray-address out" % address
        ) from None
