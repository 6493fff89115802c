"""Workers as child processes of this one. They end with it: a closed socket tells them."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import time
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Dict, List, Optional, Tuple

from training.workers.pool import TASK_SECONDS, NextTask, ParallelPool, Slot
from training.workers.tasks import Task, WorkerSettings, encode_settings, encode_task

ROOT = str(Path(__file__).resolve().parents[2])
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
STARTING = 60  # [s] that a worker may take to read its first message, which can be larger than the socket's buffer
HALF_A_MESSAGE = 10  # [s] that an answer may stop in the middle before its worker counts as dead


class ChildProcesses(ParallelPool):
    """`workers` child processes of one thread each."""

    def __init__(self, settings: WorkerSettings, next_task: NextTask, workers: int, task_seconds: float = TASK_SECONDS):
        super().__init__(settings, next_task, workers, task_seconds)
        self._begin()

    def _start(self, slot: Slot) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            slot.worker = subprocess.Popen(
                [sys.executable, "-m", "training.workers.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=dict(os.environ, **environment()),
                start_new_session=True,  # Ctrl-C is for this process to answer
            )
        for side, seconds in ((socket.SO_SNDTIMEO, STARTING), (socket.SO_RCVTIMEO, HALF_A_MESSAGE)):
            ours.setsockopt(socket.SOL_SOCKET, side, struct.pack("ll", seconds, 0))
        slot.link, slot.known = Connection(ours.detach()), -1
        slot.link.send_bytes(encode_settings(self.settings))

    def _send(self, slot: Slot, task: Task, weights: bytes) -> bool:
        try:
            slot.link.send_bytes(encode_task(task, weights))
            return True
        except OSError:
            return False

    def _collect(self, busy: List[Slot], timeout: float) -> List[Tuple[Slot, Optional[bytes]]]:
        slots = {slot.link: slot for slot in busy}
        if not slots:
            time.sleep(timeout)
            return []
        found: List[Tuple[Slot, Optional[bytes]]] = []
        for link in wait(list(slots), timeout):
            try:
                found.append((slots[link], link.recv_bytes()))  # type: ignore[union-attr, index]
            except (EOFError, OSError):
                found.append((slots[link], None))  # type: ignore[index]
        return found

    def _end(self, slot: Slot) -> None:
        if slot.worker is None:
            return
        slot.link.close()
        slot.worker.kill()  # it holds nothing that could be lost
        slot.worker.wait()
        slot.worker = slot.link = None


def environment() -> Dict[str, str]:
    """Variables of a worker's process: one thread, and where it finds this repository and a person's own modules."""
    path = os.pathsep.join([ROOT] + [folder for folder in sys.path if folder])
    return dict({name: "1" for name in THREADS}, PYTHONPATH=path)
