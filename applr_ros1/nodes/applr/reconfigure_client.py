"""Client for the dynamic_reconfigure servers of one move_base, this package's or the C++ one.

The applr node calls `request`, which never blocks, and reads the parameters in force with `theta()`. Names, bounds and
layers are those that the servers declare.
"""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import Future, wait
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import rospy
from dynamic_reconfigure import find_reconfigure_services
from dynamic_reconfigure.client import Client

from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.policy.parameter_space import SPACE, Space, are_in_force
from applr_ros1.robots.robot import Setting

DEADLINE_S = 1.0  # wall time for one call of all servers [s]
RESTORE_S = 3.0  # wall time for the last call at shutdown [s]; a C++ server drops calls of nodes that have ended
ANNOUNCED_S = 0.4  # longest time between a server's answer and its message on parameter_updates [s]
RETRY_S = 0.25  # pause between two attempts [s]
SEARCH_S = 1.0  # pause between two searches for the servers [s]
MOST_SEARCHES = 15  # number of failed searches before they are reported


class Server:
    """Client for one dynamic_reconfigure server: its latest values, its bounds, and calls to change them.

    A stopped process accepts calls without ever answering, and the library has no time-out. Each call therefore has a
    thread, and the next call begins only after the thread has ended, so that a late call never overwrites a newer one.

    Args:
        name: Full name of the server.
        targets: (index in theta, Setting) of the values that the server must have.
        on_restart: Called with this object when the server comes back after a restart.

    Attributes:
        settings: (index in theta, sign, name on the server) of each target.
        call: The latest call. Its result is the reason in one line why the values are not in force, or "".

    Raises:
        rospy.ROSException: The server does not answer.
        ApplrError: The server lacks a value.
    """

    def __init__(self, name: str, targets: Sequence[Tuple[int, Setting]], on_restart: Callable[[Server], None]):
        self.name, self._on_restart, self._described = name, on_restart, False
        self._restarted = False  # whether the process is new, so that `values` may be from its predecessor
        self.call: Future[str] = Future()
        self.call.set_result("")
        self._client = Client(name, DEADLINE_S, None, self._on_description)
        self.close = self._client.close
        try:
            for get in (self._client.get_parameter_descriptions, self._client.get_configuration):
                if get(DEADLINE_S) is None:
                    raise rospy.ROSException("does not publish its parameters: is it stopped?")
            self.settings = [(i, target.sign, self._name_of(target)) for i, target in targets]
        except Exception:
            self.close()
            raise

    def _name_of(self, target: Setting) -> str:
        for name in target.names:
            if name in self.declared:
                return name
        raise ApplrError(f"has no parameter {target.names[0]}")

    def _on_description(self, description: List[Dict[str, Any]]) -> None:
        if self._described:  # Each process sends its description once, so this is a new process.
            self._restarted = True
            self._on_restart(self)
        self._described = True

    @property
    def declared(self) -> Dict[str, Dict[str, Any]]:
        """Declarations of the server's parameters, as {name: {"type", "min", "max", ...}}."""
        return {parameter["name"]: parameter for parameter in self._client.param_description}

    @property
    def values(self) -> Mapping[str, Any]:
        """Values {name: value} of the server's latest message."""
        config: Dict[str, Any] = self._client.config
        return config

    def has(self, values: Mapping[str, Any]) -> bool:
        """Return whether the values {name: value} are in force. False until a restarted server has been set."""
        return not self._restarted and are_in_force(values, self.values)

    def request(self, values: np.ndarray) -> Dict[str, float]:
        """Return this server's part of values (n,) as {name: value}. The library converts the types."""
        return {name: float(sign * values[i]) for i, sign, name in self.settings}

    def set(self, values: Mapping[str, Any]) -> None:
        """Begin a call that sets {name: value}. The former call must have ended."""
        self.call = Future()
        threading.Thread(target=self._set, args=(dict(values), self.call), daemon=True).start()

    def _set(self, values: Dict[str, Any], call: Future[str]) -> None:
        """Wait for parameter_updates as well: a server's answer may differ from what it then applies."""
        try:
            self._client.update_configuration(dict(values))
            self._restarted = False
            until = time.monotonic() + ANNOUNCED_S
            while not self.has(values) and time.monotonic() < until:
                time.sleep(0.002)
            other = next((name for name in values if not self.has({name: values[name]})), "")
            error = other and f"{self.name}: {other} is {self.values.get(other)} instead of {values[other]}"
        except Exception as problem:  # The library raises an error of its own in place of the server's.
            answer = problem.__context__ if isinstance(problem.__context__, rospy.ServiceException) else problem
            error = f"{self.name}: {reason(answer)}"
        call.set_result(error)


class ReconfigureClient:
    """Client for the parameters of one move_base.

    `apply` sets parameters and waits for the result. `request` leaves this to the client's thread, which retries until
    the parameters are in force. Both clip to the ranges of the space, round integers, and refuse values that are not
    finite.

    Args:
        namespace: Namespace of move_base.
        space: The parameters, and the servers that have them.
        on_restart: Called with a Server that came back after a restart, from a callback's thread.
        on_report: Called with the result of every attempt at a request, as `apply` returns it, from the client's
            thread.
        on_trouble: Called from the client's thread with one line while servers are missing, and with "" once all are
            found.

    Attributes:
        multipliers: Factors (n,) applied to parameters on their way to the planner, set by MeterScoring.
    """

    def __init__(
        self,
        namespace: str = "/move_base",
        space: Space = SPACE,
        on_restart: Callable[[Server], None] = lambda server: None,
        on_report: Callable[[str], None] = lambda error: None,
        on_trouble: Callable[[str], None] = lambda line: None,
    ):
        self.namespace, self.space = namespace.rstrip("/"), space
        self._on_restart, self._on_report, self._on_trouble = on_restart, on_report, on_trouble
        self._requested: Optional[np.ndarray] = None  # theta (n,) of the last request
        self._in_force: Optional[np.ndarray] = None  # the object `_requested` once it is in force
        self._stopped = False
        self._asking, self._wake = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="reconfigure_client", daemon=True)
        self._servers: Dict[str, Server] = {}  # servers by their names in the space
        self.multipliers = np.ones(len(space))
        self._sent: Optional[Tuple[np.ndarray, np.ndarray]] = None  # (theta, values) of the last apply
        self._lock = threading.Lock()  # allows one apply at a time

    @property
    def connected(self) -> bool:
        """True if all servers of the space have been found."""
        return len(self._servers) == len(self.space.servers)

    @property
    def sent(self) -> Optional[np.ndarray]:
        """Theta (n,) of the last apply, which some servers may have refused. None before the first apply."""
        return None if self._sent is None else self._sent[0]

    @property
    def servers(self) -> Dict[str, str]:
        """Full names of the servers found so far, by their names in the space."""
        return {wanted: server.name for wanted, server in self._servers.items()}

    def connect(self) -> str:
        """Find the servers. Return "" if all are known, otherwise one line about the missing one."""
        try:
            running = find_reconfigure_services()
        except Exception as problem:  # rosservice has exceptions of its own.
            return f"no ROS master: {reason(problem)}"
        for wanted in [wanted for wanted in self.space.servers if wanted not in self._servers]:
            error = f"no parameter server for {wanted or 'move_base'} below {self.namespace}: is move_base up?"
            for name in self._candidates(wanted, running):
                try:
                    self._servers[wanted] = Server(name, self.space.targets_of(wanted), self._on_restart)
                    break
                except rospy.ROSException as problem:
                    error = f"{name}: {reason(problem)}"
                except ApplrError as problem:
                    error = f"{name} {problem}, which the {wanted or 'move_base'} of a {self.space.robot} needs"
            else:
                return error
        return ""

    def _candidates(self, wanted: str, running: List[str]) -> List[str]:
        """Return the names of running servers that may be the space's server `wanted`, likeliest first.

        The names of layers depend on move_base's parameter files. Every server in the same namespace is therefore a
        candidate, and those with the longest common prefix come first.
        """
        place, _, last = f"{self.namespace}/{wanted}".rstrip("/").rpartition("/")
        there = [name for name in running if name.rpartition("/")[0] == place]
        if not wanted:
            return [name for name in there if name == self.namespace]
        if "/" not in wanted and not wanted.endswith("_costmap"):
            there = [name for name in there if not name.endswith("_costmap")]

        def alike(name: str) -> int:
            return len(os.path.commonprefix([name.rpartition("/")[2].lower(), last.lower()]))

        return sorted(there, key=lambda name: (-alike(name), name))

    def values(self) -> Optional[np.ndarray]:
        """Return the planner's latest values (n,) float64. If several servers have a value, the first counts.

        None before `connect` has succeeded, and while a server's value is not a number.
        """
        if not self.connected:
            return None
        values = np.empty(len(self.space))
        for i, (server, _) in enumerate(self.space.places()):
            has = self._servers[server]
            name = next(name for j, sign, name in has.settings if j == i and sign > 0)
            if not isinstance(has.values.get(name), (bool, int, float)):
                return None
            values[i] = has.values[name]
        return values

    def theta(self) -> Optional[np.ndarray]:
        """Return the parameter set (n,) in force, without multipliers. None if `values` is None."""
        values, sent = self.values(), self._sent
        if values is None:
            return None
        if sent is not None and np.array_equal(values, sent[1]):
            return sent[0].copy()
        return values / self.multipliers

    def bounds(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest values (n,) that all servers accept."""
        low, high = np.full((2, len(self.space)), [[-np.inf], [np.inf]])
        for server in self._servers.values():
            declared = server.declared
            for i, sign, name in server.settings:
                least, most = sorted(sign * declared[name][end] for end in ("min", "max"))
                low[i], high[i] = max(low[i], least), min(high[i], most)
        return low, high

    def apply(self, theta: np.ndarray, seconds: float = DEADLINE_S) -> str:
        """Set theta (n,) times `multipliers`, within the servers' bounds, and read the values back.

        The servers are called in parallel. A server whose values are in force already is not called, because every call
        of a costmap's server in C++ clears the costmap.

        Args:
            theta: Parameters (n,).
            seconds: Wall time for all answers [s].

        Returns:
            "" if every value is in force, otherwise one line about the servers that refused, are gone or did not
            answer. The other servers have their new values, and the next attempt sets the missing ones.

        Raises:
            ApplrError: A value is not finite. Nothing was sent.
        """
        theta = self.space.clip(theta)
        with self._lock:
            if not self.connected:
                return f"no parameter servers below {self.namespace} yet"
            self._sent = theta, theta * self.multipliers
            values, servers = np.clip(self._sent[1], *self.bounds()), list(self._servers.values())
            for server in servers:
                if server.call.done() and not server.has(server.request(values)):
                    server.set(server.request(values))
            wait([server.call for server in servers], seconds)
            errors = []
            for server in servers:
                if not server.call.done():
                    errors.append(f"{server.name} does not answer")
                elif not server.has(server.request(values)):
                    errors.append(server.call.result() or f"{server.name} was busy with an earlier call")
            return "; ".join(errors)

    def start(self) -> None:
        """Start the thread that applies requests, including an earlier one."""
        self._thread.start()

    def request(self, theta: np.ndarray) -> np.ndarray:
        """Queue theta (n,) in place of the former request, and return it clipped to the ranges.

        Raises ApplrError without changing anything if a value is not finite.
        """
        theta = self.space.clip(theta)
        with self._asking:
            self._requested = theta
        self._wake.set()
        return theta

    def reapply(self) -> None:
        """Apply the present request again, for example after a server came back with its start-up values."""
        with self._asking:  # A new object counts as a new request, even if an attempt is under way.
            self._requested = None if self._requested is None else self._requested.copy()
        self._wake.set()

    @property
    def busy(self) -> bool:
        """True until the latest request is in force."""
        return self._requested is not self._in_force

    def stop(self) -> None:
        """End the thread and drop the open request."""
        self._stopped = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(DEADLINE_S + 0.1)  # No attempt takes longer.

    def close(self) -> None:
        """End the thread and unsubscribe from all servers."""
        self.stop()
        for server in self._servers.values():
            server.close()

    def _run(self) -> None:
        searches = 0
        while not self._stopped:
            pause, theta = SEARCH_S, self._requested
            try:
                if not self.connected:
                    trouble, searches = self.connect(), searches + 1
                    if not trouble or searches >= MOST_SEARCHES:
                        self._on_trouble(trouble)
                    pause = SEARCH_S if trouble else 0.0
                elif theta is not None and self.busy:
                    error, pause = self.apply(theta), RETRY_S
                    if not error:
                        self._in_force = theta
                    self._on_report(error)
            except Exception as e:  # The thread must survive any error.
                self._on_trouble(f"parameters not applied ({type(e).__name__}: {e})")
            self._wake.wait(pause)
            self._wake.clear()
