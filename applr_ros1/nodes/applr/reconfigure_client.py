"""Sets the parameters of a space in a running move_base, ours or the C++ one, all or none.

The applr node's worker calls `apply`; the node reads `theta()`, what the planner really has. Each server has a client
of dynamic_reconfigure's own library. Which names, bounds and layers exist is found out, not assumed.
"""

from __future__ import annotations

import os
import threading
import time
import xmlrpc.client
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import numpy as np
import rosgraph
import rospy
from dynamic_reconfigure import find_reconfigure_services
from dynamic_reconfigure.client import Client

from applr_ros1.common.errors import reason
from applr_ros1.policy.distance_weights import Compensation
from applr_ros1.policy.parameter_space import SPACE, Space

DEADLINE = 1.0  # s of wall time for one call of all servers
_KINDS: Dict[str, Callable[[Any], Any]] = {"bool": bool, "int": lambda v: int(np.rint(v)), "double": float, "str": str}


@dataclass
class ApplyReport:
    """What came of one `apply`.

    ok: every value is in force, read back; theta: (n,) asked for; error: one line; put_back: servers returned to their
    former values; unanswered: servers that still have a call to answer; seconds: wall time it took.
    """

    ok: bool
    theta: np.ndarray
    error: str = ""
    put_back: Tuple[str, ...] = ()
    unanswered: Tuple[str, ...] = ()
    seconds: float = 0.0


class Server:
    """One dynamic_reconfigure server: its values as last heard, its bounds, and calls to change it.

    A stopped process accepts a call and never answers, and the library has no time-out for that. So each call has a
    thread of its own, and there is no second one before it has ended: a late call never undoes a newer one.
    """

    def __init__(self, name: str, timeout: float, on_restart: Callable[[Server], None]):
        self.name, self._on_restart = name, on_restart
        self._parameters: Dict[str, Dict[str, Any]] = {}
        self._call: Optional[Future] = None  # the newest one
        self._client = Client(name, timeout, description_callback=self._on_description)

    def close(self) -> None:
        """Unsubscribe from the server's topics."""
        self._client.close()

    def wait(self, seconds: float) -> bool:
        """Wait until values and bounds are known; False when they are not within `seconds` of wall time."""
        described = self._client.get_parameter_descriptions(seconds) is not None
        return described and self._client.get_configuration(seconds) is not None

    @property
    def values(self) -> Mapping[str, Any]:
        """{name: value} as last heard."""
        return self._client.config

    def knows(self, name: str) -> bool:
        """Whether the server has a parameter of that name."""
        return name in self._parameters

    def clamp(self, name: str, value: float) -> Any:
        """`value` inside the bounds and as the type that the server declares."""
        declared = self._parameters[name]
        return _KINDS[declared["type"]](min(max(value, declared["min"]), declared["max"]))

    def upper_bound(self, name: str) -> float:
        """The largest value that the server declares for a parameter."""
        return self._parameters[name]["max"]

    @property
    def unanswered(self) -> Optional[Future]:
        """The call that the server has still to answer."""
        return None if self._call is None or self._call.done() else self._call

    def set(self, values: Mapping[str, Any]) -> Future:
        """Begin a call, with no other unanswered; its result is what is in force then."""
        future: Future = Future()

        def call() -> None:
            try:
                self._client.config = self._client.update_configuration(dict(values))
                future.set_result(self._client.config)
            except Exception as error:
                future.set_exception(error)

        self._call = future
        threading.Thread(target=call, daemon=True).start()
        return future

    def problem(self, future: Future, values: Mapping[str, Any]) -> str:
        """Why the values are not in force after a call; "" if they are."""
        if not future.done():
            return f"{self.name} does not answer"
        error = future.exception()
        if error is not None:  # the library hides what the server said behind an error of its own
            said = error.__context__ if isinstance(error.__context__, rospy.ServiceException) else error
            return f"{self.name}: {reason(said)}"
        got = future.result()
        other = next((name for name, value in values.items() if got.get(name) != value), None)
        return "" if other is None else f"{self.name} holds {other} at {got.get(other)}, not {values[other]}"

    def _on_description(self, description: List[Dict[str, Any]]) -> None:
        anew = bool(self._parameters)  # each server sends it once
        self._parameters = {parameter["name"]: parameter for parameter in description}
        if anew:
            self._on_restart(self)


class ReconfigureClient:
    """The parameters of one move_base.

    namespace: of move_base. space: which parameters, and the servers that hold them. on_restart(server): called when a
    server came back after a restart, from a callback's thread. Make it after rospy.init_node.
    """

    def __init__(
        self,
        namespace: str = "/move_base",
        space: Space = SPACE,
        on_restart: Callable[[Server], None] = lambda server: None,
    ):
        self.namespace, self.space = namespace.rstrip("/"), space
        self._on_restart = on_restart
        self._servers: Dict[str, Server] = {}  # by their names in the space
        self._names: Dict[str, List[Tuple[int, int, str]]] = {}  # the same -> [(index in theta, sign, name)]
        self.compensation = Compensation(space)  # what is sent instead of theta, and back
        self._sent: Optional[Tuple[np.ndarray, np.ndarray]] = None  # (theta, values) of the last apply
        self._lock = threading.Lock()  # one apply at a time

    @property
    def connected(self) -> bool:
        """Whether all servers of the space have been found."""
        return len(self._names) == len(self.space.servers)

    @property
    def servers(self) -> Dict[str, str]:
        """{server as the space names it: its full name as found}."""
        return {wanted: server.name for wanted, server in self._servers.items()}

    def connect(self) -> str:
        """Finds the servers. Returns "" when all are known, else one line saying what is missing."""
        try:
            found = find_reconfigure_services()
        except Exception as problem:  # rosservice has errors of its own
            return f"no ROS master: {reason(problem)}"
        for wanted in self.space.servers:
            if wanted in self._names:
                continue
            error = f"no parameter server for {wanted or 'move_base'} below {self.namespace}: is move_base up?"
            for name in self._candidates(wanted, found):
                error = self._try(wanted, name)
                if not error:
                    break
            if error:
                return error
        return ""

    def is_move_base_starting(self) -> bool:
        """Whether a node of move_base's name lives and has no parameter server yet: it may be compiling its kernels."""
        try:
            if any(name.startswith(self.namespace) for name in find_reconfigure_services()):
                return False
            uri = rosgraph.Master(rospy.get_name()).lookupNode(self.namespace)
            xmlrpc.client.ServerProxy(uri).getPid(rospy.get_name())
        except Exception:  # whichever of the two does not answer
            return False
        return True

    def _candidates(self, wanted: str, found: List[str]) -> List[str]:
        """Names of servers that may be the one that the space calls `wanted`, likeliest first.

        move_base names its layers as its parameter files do: every server in the same place is tried, beginning with
        the names that begin most alike.
        """
        place, _, last = f"{self.namespace}/{wanted}".rstrip("/").rpartition("/")
        there = [name for name in found if name.rpartition("/")[0] == place]
        if not wanted:
            return [name for name in there if name == self.namespace]
        if "/" not in wanted and not wanted.endswith("_costmap"):
            there = [name for name in there if not name.endswith("_costmap")]

        def alike(name: str) -> int:
            return len(os.path.commonprefix([name.rpartition("/")[2].lower(), last.lower()]))

        return sorted(there, key=lambda name: (-alike(name), name))

    def _try(self, wanted: str, name: str) -> str:
        """Takes server `name` for `wanted` if it has the parameters. Returns "" or one line why not."""
        try:
            server = Server(name, DEADLINE, self._on_restart)
        except rospy.ROSException as problem:
            return f"{name}: {reason(problem)}"
        error = "" if server.wait(DEADLINE) else f"{name} does not publish its parameters: is it stopped?"
        names = []
        for i, target in [] if error else self.space.targets_of(wanted):
            chosen = next((n for n in target.names if server.knows(n)), None)
            if chosen is None:
                of = f"the {wanted or 'move_base'} of a {self.space.robot} has it"
                error = error or f"{name} has no parameter {target.names[0]}: {of}"
            else:
                names.append((i, target.sign, chosen))
        if error:
            server.close()
        else:
            self._servers[wanted], self._names[wanted] = server, names
        return error

    def values(self) -> Optional[np.ndarray]:
        """(n,) float64: what the planner has, as last heard; of a value that several servers hold, the first counts.

        None before `connect` has succeeded.
        """
        if not self.connected:
            return None
        places = enumerate(self.space.places())
        return np.array([self._servers[server].values[self._name(i, server)] for i, (server, _) in places])

    def _name(self, index: int, wanted: str) -> str:
        """What the server `wanted` calls the parameter with this index in theta."""
        return next(name for i, sign, name in self._names[wanted] if i == index and sign > 0)

    def theta(self) -> Optional[np.ndarray]:
        """(n,) float64: what the planner's values mean as a parameter set; None before `connect` has succeeded."""
        values, sent = self.values(), self._sent
        if values is None:
            return None
        if sent is not None and np.array_equal(values, sent[1]):
            return sent[0].copy()
        return self.compensation.incoming(values)

    def upper_bound(self, *indices: int) -> float:
        """The smallest upper bound that the servers declare for these parameters of theta; inf for none."""
        names = [(server, name) for server in self._names for i, _, name in self._names[server] if i in indices]
        return min((self._servers[server].upper_bound(name) for server, name in names), default=np.inf)

    def holds(self, values: np.ndarray) -> bool:
        """Whether values (n,) lie within the bounds that the servers declare."""
        return all(
            self._servers[server].clamp(name, sign * values[i]) == sign * values[i]
            for server, names in self._names.items()
            for i, sign, name in names
        )

    def apply(self, theta: np.ndarray, seconds: float = DEADLINE) -> ApplyReport:
        """Sets theta (n,) on all servers, one call each and side by side, and verifies the answers.

        What is sent is `compensation`.outgoing(theta), within the servers' bounds.

        Raises ApplrError before anything is sent when a value is not finite. Otherwise never raises and ends within
        `seconds` (twice that where values have to be put back): see ApplyReport. If one server refuses, is gone or
        does not answer, those that took the new values get their former ones back. Nothing is sent while a server
        still has a former call to answer.
        """
        theta = self.space.clip(theta)
        began = time.monotonic()
        with self._lock:
            if not self.connected:
                return ApplyReport(False, theta, f"no parameter servers below {self.namespace} yet")
            servers = self._servers
            wait([server.unanswered for server in servers.values() if server.unanswered], seconds)
            unanswered = tuple(server.name for server in servers.values() if server.unanswered)
            put_back: Tuple[str, ...] = ()
            if unanswered:
                errors = {name: f"{name} does not answer" for name in unanswered}
            else:
                values = self.compensation.outgoing(theta)
                self._sent = theta, values
                requests = {
                    wanted: {name: servers[wanted].clamp(name, sign * values[i]) for i, sign, name in names}
                    for wanted, names in self._names.items()
                }
                former = {
                    wanted: {name: servers[wanted].values[name] for name in request}
                    for wanted, request in requests.items()
                }
                errors = self._set_all(requests, began + seconds - time.monotonic())
                if errors:
                    again = {wanted: former[wanted] for wanted in former if not servers[wanted].unanswered}
                    failed = self._set_all(again, seconds)
                    put_back = tuple(servers[wanted].name for wanted in again if wanted not in failed)
                unanswered = tuple(server.name for server in servers.values() if server.unanswered)
        took = time.monotonic() - began
        return ApplyReport(not errors, theta, "; ".join(errors.values()), put_back, unanswered, took)

    def _set_all(self, requests: Mapping[str, Mapping[str, Any]], seconds: float) -> Dict[str, str]:
        """{server: {name: value}} set side by side. Returns {server: why not} of those that failed."""
        calls = {wanted: self._servers[wanted].set(values) for wanted, values in requests.items()}
        wait(calls.values(), seconds)
        problems = {wanted: self._servers[wanted].problem(call, requests[wanted]) for wanted, call in calls.items()}
        return {wanted: problem for wanted, problem in problems.items() if problem}

    def close(self) -> None:
        """Unsubscribe from all servers."""
        for server in self._servers.values():
            server.close()
