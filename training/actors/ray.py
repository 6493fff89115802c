"""Workers as Ray actors, here or on a cluster whose nodes have this repository at the same path."""

from __future__ import annotations

import os
import socket
import sys
from functools import lru_cache
from typing import Any, Callable, Dict

from applr_ros1.common.errors import ApplrError, reason
from training.actors.local import environment
from training.actors.pool import NextTask, ParallelPool, WorkerDied
from training.actors.tasks import Answer, Task, WorkerSettings
from training.actors.worker import Worker


class RayPool(ParallelPool):
    """`workers` actors of Ray at `address`, with "local" of a Ray that is started on this machine."""

    def __init__(self, settings: WorkerSettings, next_task: NextTask, workers: int, address: str, task_seconds: float):
        self._ray = ray = start_ray(address, workers)
        remote = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Worker)
        put = lru_cache(maxsize=2)(ray.put)  # a policy lies once in Ray's store, for all actors
        super().__init__(
            settings, next_task, workers, lambda: RayActor(ray, remote.remote(settings), put), task_seconds
        )

    def close(self) -> None:
        """End the actors and leave Ray."""
        super().close()
        self._ray.shutdown()


class RayActor:
    """An actor (pool.Link)."""

    def __init__(self, ray: Any, actor: Any, put: Callable[[bytes], Any]):
        self._ray, self._actor, self._put = ray, actor, put
        self._ready = actor.__ray_ready__.remote()

    @property
    def has_place(self) -> bool:
        """Whether a node has taken it."""
        return bool(self._ray.wait([self._ready], timeout=0)[0])

    def ask(self, task: Task, policy: bytes, seconds: float) -> Answer:
        """The answer to a task. Raises WorkerDied."""
        try:
            return self._ray.get(self._actor.run.remote(task, self._put(policy) if policy else b""), timeout=seconds)
        except self._ray.exceptions.GetTimeoutError:
            raise WorkerDied(f"gave no answer for {seconds:g} s") from None
        except self._ray.exceptions.RayError as error:
            print(reason(error), file=sys.stderr)
            raise WorkerDied("died") from None

    def end(self) -> None:
        """End the actor."""
        try:
            self._ray.kill(self._actor)
        except Exception as error:  # it is dead, or its node is; Ray raises many kinds
            print(f"Ray: {reason(error)}", file=sys.stderr)


def start_ray(address: str, workers: int) -> Any:
    """The ray module, connected. Raises ApplrError with one line where nothing answers there.

    A Ray that is started here listens on the loopback interface only, and has no dashboard.
    """
    if address == "local":
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # read when ray is imported: no cluster, so no other host
    import ray

    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    options: Dict[str, Any] = {
        "include_dashboard": False,
        "log_to_driver": True,
        "logging_level": "ERROR",
        "runtime_env": {"env_vars": environment()},
        "address": address,
    }
    if address == "local":
        options.update(num_cpus=workers, _node_ip_address="127.0.0.1")
    else:
        _check_address(address)
    if not ray.is_initialized():
        try:
            ray.init(**options)
        except Exception as error:  # Ray raises many kinds
            raise ApplrError(f"Ray cannot be started ({address}): {reason(error)}") from None
    if address != "local" and os.environ.get("RAY_AUTH_MODE") != "token":
        print(f"Ray at {address} takes work from anybody who reaches it: set RAY_AUTH_MODE=token", file=sys.stderr)
    return ray


def _check_address(address: str, seconds: float = 5.0) -> None:
    """Whether anything listens there; Ray itself would wait for minutes."""
    if address == "auto":
        return
    host, _, port = (address[len("ray://") :] if address.startswith("ray://") else address).rpartition(":")
    try:
        socket.create_connection((host or "127.0.0.1", int(port)), seconds).close()
    except (OSError, ValueError, OverflowError):
        raise ApplrError(
            f"no Ray answers at {address}; start a head node there (ray start --head) or leave --ray-address out"
        ) from None
