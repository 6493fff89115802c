"""Process that answers why the robot stopped: one at a time, at low priority.

The messages go to it through a pipe, so that it needs no disk. It prints an answer a line.
"""

from __future__ import annotations

import json
import marshal
import subprocess
import threading
import time
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, Dict, Iterable, Optional, Sequence

from applr_ros1.why.black_box.bag_file import RawMessage

NICE = "10"  # priority of the process, far behind the control loop
LONGEST_S = 60.0  # time after which a process that has not ended is killed [s]
PATIENCE_S = 6.0  # time after which the first answer is given, if the last one is not there [s]
ENDS_S = 1.0  # longest time to wait for the last line of a process that has ended [s]


class AnswerProcess:
    """Starts the process for a stop, and ends it if the next stop comes.

    Args:
        command: Command that reads the messages, and prints answers.
    """

    def __init__(self, command: Sequence[str]):
        self._command = ["nice", "-n", NICE, *command]
        self._job: Optional[_Job] = None

    @property
    def is_running(self) -> bool:
        """True while the process answers."""
        return self._job is not None and self._job.process.poll() is None

    def ask(self, messages: Iterable[RawMessage]) -> bool:
        """Start the process for a stop.

        Args:
            messages: Messages around it, with its description, which are taken while they are sent.

        Returns:
            Whether the answer to the stop before is dropped for this one.
        """
        is_dropped = self.is_running
        self.end()
        process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._job = _Job(process)
        sender = threading.Thread(target=_send, args=[process, messages], daemon=True)
        sender.start()
        return is_dropped

    def answer(self) -> Optional[Dict[str, Any]]:
        """Return the answer, or None if there is no new one.

        The first lines are known early. They are returned only if the last one takes long.
        """
        job = self._job
        if job is None:
            return None
        elapsed = time.monotonic() - job.begin_time
        has_ended = job.process.poll() is not None
        if not has_ended and elapsed > LONGEST_S:
            self.end()
        if has_ended:
            job.listener.join(ENDS_S)
            self._job = None
        if not has_ended and elapsed < PATIENCE_S:
            return None
        latest_answer = job.given_answer
        with suppress(Empty):
            while True:
                latest_answer = job.answers.get_nowait()
        # The last answer may be the first one, which was given before.
        if latest_answer == job.given_answer:
            return None
        job.given_answer = latest_answer
        return latest_answer

    def end(self) -> None:
        """End the process, if there is one."""
        if self._job is not None:
            self._job.process.kill()
            self._job.process.wait()
            self._job = None


class _Job:
    """Running process that answers.

    Attributes:
        process: The process.
        answers: Answers that it has printed.
        listener: Thread that reads them.
        given_answer: Answer that was returned; None before the first one.
        begin_time: time.monotonic() of its begin.
    """

    def __init__(self, process: subprocess.Popen[bytes]):
        self.process = process
        self.answers: SimpleQueue[Dict[str, Any]] = SimpleQueue()
        self.given_answer: Optional[Dict[str, Any]] = None
        self.listener = threading.Thread(target=_listen, args=[process, self.answers], daemon=True)
        self.listener.start()
        self.begin_time = time.monotonic()


def _send(process: subprocess.Popen[bytes], messages: Iterable[RawMessage]) -> None:
    pipe: Any = process.stdin
    with suppress(OSError), pipe:  # The process was ended for the next stop.
        for time, publication, data in messages:
            marshal.dump((time, tuple(publication), data), pipe)


def _listen(process: subprocess.Popen[bytes], answers: SimpleQueue[Dict[str, Any]]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        with suppress(ValueError):  # A library may print lines of its own.
            answers.put(json.loads(line))
