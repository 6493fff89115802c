"""Workers as Ray actors, here or on a cluster whose nodes have this repository at the same path."""

from __future__ import annotations

import logging
import os
import socket
import sys
from typing import Any, Callable, Dict, Tuple

from applr_ros1.common.errors import ApplrError, reason
from training.workers.pool import Answer, WorkerDied, attempt, environment


class RayCluster:
    """A Ray at an address, with "local" one that is started on this machine for so many workers.

    That one listens on the loopback interface only, and has no dashboard.

    Raises:
        ApplrError: with one line, where nothing answers there.
    """

    def __init__(self, address: str, workers: int):
        if address == "local":
            os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # read when ray is imported: so no other host
        else:
            _check_address(address)
        import ray

        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        options: Dict[str, Any] = {"num_cpus": workers, "_node_ip_address": "127.0.0.1"} if address == "local" else {}
        if not ray.is_initialized():
            try:
                options.update(include_dashboard=False, logging_level=logging.ERROR)
                ray.init(address, runtime_env={"env_vars": environment()}, **options)
            except Exception as error:  # Ray raises many kinds
                raise ApplrError(f"Ray cannot be started ({address}): {reason(error)}") from None
        if address != "local" and os.environ.get("RAY_AUTH_MODE") != "token":
            print(f"Ray at {address} takes work from anybody who reaches it: set RAY_AUTH_MODE=token", file=sys.stderr)
        self.ray = ray

    def actor(self) -> RayActor:
        """Start an actor, which waits where no node has a place for it."""
        return RayActor(self.ray)


class RayActor:
    """An actor that executes calls one after the other, as a ChildProcess does. placed: whether a node has taken it."""

    placed = False

    def __init__(self, ray: Any):
        self._ray, self.actor = ray, ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_Process).remote()

    def wait(self) -> None:
        """Return when a node has taken it, or it is dead."""
        try:
            self._ray.get(self.actor.__ray_ready__.remote())
            self.placed = True
        except self._ray.exceptions.RayError:
            return  # the next call says so

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Answer:
        """Return what attempt() gives there; raises WorkerDied."""
        try:
            return self._ray.get(self.actor.attempt.remote(function, *args), timeout=seconds)
        except self._ray.exceptions.GetTimeoutError:
            raise WorkerDied(f"gave no answer for {seconds:g} s") from None
        except self._ray.exceptions.RayError as error:
            print(reason(error), file=sys.stderr)
            raise WorkerDied("died") from None

    def end(self) -> None:
        """End the actor."""
        try:
            self._ray.kill(self.actor)
        except Exception as error:  # it is dead, or its node is; Ray raises many kinds
            print(f"Ray: {reason(error)}", file=sys.stderr)


class _Process:
    """Part that runs in an actor's process."""

    def attempt(self, function: Callable[..., Any], *args: Any) -> Answer:
        return attempt(function, args)


def _check_address(address: str, seconds: float = 5.0) -> None:
    """Raise ApplrError where nothing listens there; Ray itself would wait for minutes."""
    if address == "auto":
        return
    host, _, port = (address[len("ray://") :] if address.startswith("ray://") else address).rpartition(":")
    try:
        socket.create_connection((host or "127.0.0.1", int(port)), seconds).close()
    except (OSError, ValueError, OverflowError):
        raise ApplrError(
            f"no Ray answers at {address}; start a head node there (ray start --head) or leave --ray-address out"
        ) from None
