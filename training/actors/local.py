"""A worker as a child process of this one. It ends with it: a closed socket tells it."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Dict

from training.actors.pool import WorkerDied
from training.actors.tasks import Answer, Task, WorkerSettings

ROOT = str(Path(__file__).resolve().parents[2])
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
STARTING = 60  # [s] that a worker may take to read its first message, which can be larger than the socket's buffer
HALF_A_MESSAGE = 10  # [s] that an answer may stop in the middle before its worker counts as dead


class ChildProcess:
    """A child process of one thread, and the socket to it (pool.Link)."""

    has_place = True

    def __init__(self, settings: WorkerSettings):
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setblocking(True)  # also where ROS has set a default timeout for the sockets of this process
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "training.actors.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=dict(os.environ, **environment()),
                start_new_session=True,  # Ctrl-C is for this process to answer
            )
        for side, seconds in ((socket.SO_SNDTIMEO, STARTING), (socket.SO_RCVTIMEO, HALF_A_MESSAGE)):
            ours.setsockopt(socket.SOL_SOCKET, side, struct.pack("ll", seconds, 0))
        self._connection = Connection(ours.detach())
        self._connection.send(settings)

    def ask(self, task: Task, policy: bytes, seconds: float) -> Answer:
        """The answer to a task. Raises WorkerDied."""
        try:
            self._connection.send((task, policy))
            if self._connection.poll(seconds):
                return self._connection.recv()
        except (EOFError, OSError):
            raise WorkerDied("died") from None
        raise WorkerDied(f"gave no answer for {seconds:g} s")

    def end(self) -> None:
        """End the process; it holds nothing that could be lost."""
        self.process.kill()
        self.process.wait()


def environment() -> Dict[str, str]:
    """Variables of a worker's process: one thread, and where it finds this repository and a person's own modules."""
    path = os.pathsep.join([ROOT] + [folder for folder in sys.path if folder])
    return dict({name: "1" for name in THREADS}, PYTHONPATH=path)
