"""Where evaluation trials are driven: processes of one thread each, or Ray actors. evaluate.py holds one pool.

One interface: `give(slot, task)` for each free slot, `wait()` for answers; None as an answer says that the worker died,
and that a new one stands ready in its slot.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

from training.evaluation.trial_worker import THREADS

ROOT = str(Path(__file__).resolve().parents[2])

Answer = Tuple[int, Optional[Dict[str, Any]]]


class Processes:
    """`count` child processes. close() ends them, by their own ids."""

    def __init__(self, count: int, settings: Dict[str, Any]):
        self.settings = settings
        self._selector = selectors.DefaultSelector()
        self._children: List[Optional[_Child]] = [None] * count
        for slot in range(count):
            self._start(slot)

    def give(self, slot: int, task: Dict[str, Any]) -> None:
        self._children[slot].send(task)

    def wait(self, timeout: float = 1.0) -> List[Answer]:
        answers = []
        for key, _ in self._selector.select(timeout):
            line = self._children[key.data].answers.readline()
            if line.endswith("\n"):
                answers.append((key.data, json.loads(line)))
            else:
                self._end(key.data)
                self._start(key.data)
                answers.append((key.data, None))
        return answers

    def close(self) -> None:
        for slot, child in enumerate(self._children):
            if child is not None:
                self._end(slot)
        self._selector.close()

    def _start(self, slot: int) -> None:
        self._children[slot] = child = _Child(self.settings)
        self._selector.register(child.answers, selectors.EVENT_READ, slot)

    def _end(self, slot: int) -> None:
        child, self._children[slot] = self._children[slot], None
        self._selector.unregister(child.answers)
        child.end()


class _Child:
    def __init__(self, settings: Dict[str, Any]):
        read, write = os.pipe()
        env = dict(os.environ, **{name: "1" for name in THREADS})
        env["PYTHONPATH"] = os.pathsep.join([ROOT] + [p for p in sys.path if p])  # a person's module:Class, too
        self.process = subprocess.Popen(
            [sys.executable, "-m", "training.evaluation.trial_worker", str(write)],
            pass_fds=(write,),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            env=env,
        )
        os.close(write)
        self.answers = os.fdopen(read)
        self.send(settings)

    def send(self, message: Dict[str, Any]) -> None:
        try:
            self.process.stdin.write(json.dumps(message) + "\n")
            self.process.stdin.flush()
        except OSError:  # it has died: its end of file on `answers` will say so
            pass

    def end(self) -> None:
        self.process.kill()  # it holds nothing that could be lost
        self.process.wait()
        try:  # noqa: SIM105
            self.process.stdin.close()
        except OSError:
            pass
        self.answers.close()


class RayActors:
    """`count` actors of Ray, at `address` (whose nodes have this repo at the same path)."""

    def __init__(self, count: int, settings: Dict[str, Any], address: str):
        from training.gorila.actor_pool import start_ray

        self._ray, self._settings = start_ray(address, count), settings
        self._class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_RayDriver)
        self._actors = [self._new() for _ in range(count)]
        self._waiting: Dict[Any, int] = {}

    def give(self, slot: int, task: Dict[str, Any]) -> None:
        self._waiting[self._actors[slot].run.remote(json.dumps(task))] = slot

    def wait(self, timeout: float = 1.0) -> List[Answer]:
        ready, _ = self._ray.wait(list(self._waiting), num_returns=1, timeout=timeout)
        answers: List[Answer] = []
        for reference in ready:
            slot = self._waiting.pop(reference)
            try:
                answers.append((slot, json.loads(self._ray.get(reference))))
            except self._ray.exceptions.RayError:
                self._actors[slot] = self._new()
                answers.append((slot, None))
        return answers

    def close(self) -> None:
        for actor in self._actors:
            self._ray.kill(actor)
        self._ray.shutdown()

    def _new(self):
        return self._class.remote(json.dumps(self._settings))


class _RayDriver:
    def __init__(self, settings: str):
        for name in THREADS:
            os.environ[name] = "1"
        from training.evaluation.trial_worker import make

        self._driver = make(json.loads(settings))

    def run(self, task: str) -> str:
        from training.evaluation.trial_worker import answer

        return json.dumps(answer(self._driver, json.loads(task)))
