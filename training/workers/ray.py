"""Workers on a local or remote Ray cluster, whose nodes have this repository at the same path."""

from __future__ import annotations

import logging
import os
import socket
import sys
from typing import Any, Callable, Dict, Tuple

from applr_ros1.common.errors import ApplrError, reason
from training.workers.calls import WorkerDied, attempt, environment


def connect(address: str, workers: int) -> Any:
    """Return the module ray, connected to a cluster.

    Args:
        address: Address of the cluster, or "local" to start a cluster on the loopback interface,
            without a dashboard.
        workers: Number of cores of a local cluster.

    Raises:
        ApplrError: No cluster answers.
    """
    options: Dict[str, Any] = {"include_dashboard": False, "logging_level": logging.ERROR}
    if address == "local":
        # Read when ray is imported; admits no other host.
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        options.update(num_cpus=workers, _node_ip_address="127.0.0.1")
    else:
        _check_address(address)
    import ray

    # The coming default, so that Ray does not warn of the change: tasks without a GPU keep theirs.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if not ray.is_initialized():
        try:
            ray.init(address, runtime_env={"env_vars": environment()}, **options)
        except Exception as error:  # Ray raises many kinds of errors.
            raise ApplrError(f"Ray cannot be started ({address}): {reason(error)}") from None
    # Whoever reaches such a cluster can run programs on it.
    if address != "local" and os.environ.get("RAY_AUTH_MODE") != "token":
        print(
            f"Ray at {address} accepts work from anybody who can reach it: set RAY_AUTH_MODE=token",
            file=sys.stderr,
        )
    return ray


class RayWorker:
    """Worker that runs calls on a cluster one after the other.

    Each call waits until a node has a free core.
    """

    def __init__(self, ray: Any):
        self._ray = ray
        self._task = None
        self._attempt = ray.remote(num_cpus=1, max_retries=0)(attempt)

    def call(self, function: Callable[..., Any], args: Tuple[Any, ...], seconds: float) -> Any:
        """Return the result of attempt() on a node.

        Raise WorkerDied if there is none in time.
        """
        self._task = self._attempt.remote(function, args)
        try:
            return self._ray.get(self._task, timeout=seconds)
        except self._ray.exceptions.GetTimeoutError:
            raise WorkerDied(f"gave no answer for {seconds:g} s") from None
        except self._ray.exceptions.RayError as error:
            # The reason is on another machine, whose log the user may not see.
            print(reason(error), file=sys.stderr)
            raise WorkerDied("died") from None

    def end(self) -> None:
        """Kill the process that executes a call."""
        if self._task is not None:
            self._ray.cancel(self._task, force=True)


def _check_address(address: str, seconds: float = 5.0) -> None:
    """Raise ApplrError if nothing listens at the address.

    Ray itself would wait for minutes.
    """
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host or "127.0.0.1", int(port)), seconds).close()
    except (OSError, ValueError, OverflowError):
        remedy = "start a head node there (ray start --head) or leave --ray-address out"
        raise ApplrError(f"no Ray answers at {address}: {remedy}") from None
