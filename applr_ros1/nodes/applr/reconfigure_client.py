"""Sets the parameters of a space in a running move_base, ours or the C++ one, all or none.

The applr node's worker calls `apply`; the node reads `theta()`, what the planner really has. Each server has a client
of dynamic_reconfigure's own library. Which names, bounds and layers exist is found out, not assumed.
"""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import numpy as np
import rospy
from dynamic_reconfigure import find_reconfigure_services
from dynamic_reconfigure.client import Client

from applr_ros1.common.errors import reason
from applr_ros1.policy.distance_weights import Compensation
from applr_ros1.policy.parameter_space import SPACE, Space, are_in_force

DEADLINE = 1.0  # s of wall time for one call of all servers
ANNOUNCED = 0.4  # s of wall time between a server's answer and its message on parameter_updates
_KINDS: Dict[str, Callable[[Any], Any]] = {"bool": bool, "int": lambda v: int(np.rint(v)), "double": float, "str": str}


@dataclass
class ApplyReport:
    """The result of one `apply`.

    error: one line, "" where every value is in force, read back; refused: whether a server answered and has other
    values; put_back: servers returned to their former values; unanswered: servers that still have a call to answer.
    """

    error: str = ""
    refused: bool = False
    put_back: Tuple[str, ...] = ()
    unanswered: Tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether every value is in force."""
        return not self.error


class Server:
    """One dynamic_reconfigure server: its values as last heard, its bounds, and calls to change it.

    A stopped process accepts a call and never answers, and the library has no time-out for that. So each call has a
    thread of its own, and there is no second one before it has ended: a late call never undoes a newer one.

    Attributes:
        settings: (index in theta, sign, name) of each of its values that the space sets.
        refused: whether the newest call was answered, and the values are not in force.
    """

    def __init__(self, name: str, on_restart: Callable[[Server], None]):
        self.name, self._on_restart = name, on_restart
        self.settings: List[Tuple[int, int, str]] = []
        self._declared: Dict[str, Dict[str, Any]] = {}
        self._call: Optional[Future] = None  # the newest one
        self.refused = False
        self._starts = 0  # times that the server was found or came back
        self._known = 0  # the start since which its values are known; 0: a call has shown nothing of them
        self._client = Client(name, DEADLINE, description_callback=self._on_description)
        self.close = self._client.close

    def hold(self, targets: Any, owner: str) -> str:
        """Learn values and bounds, and which values the space's targets are. Returns "" or one line why not."""
        for heard in (self._client.get_parameter_descriptions(DEADLINE), self._client.get_configuration(DEADLINE)):
            if heard is None:
                return f"{self.name} does not publish its parameters: is it stopped?"
        for i, target in targets:
            name = next((name for name in target.names if name in self._declared), None)
            if name is None:
                return f"{self.name} has no parameter {target.names[0]}: {owner} has it"
            self.settings.append((i, target.sign, name))
        self._known = self._starts
        return ""

    @property
    def values(self) -> Mapping[str, Any]:
        """{name: value} as last heard."""
        return self._client.config

    def value(self, index: int) -> float:
        """The value of the parameter with this index in theta."""
        return next(self.values[name] for i, sign, name in self.settings if i == index and sign > 0)

    def request(self, values: np.ndarray) -> Dict[str, Any]:
        """{name: value} of what it holds of values (n,), within the bounds and as the types that it declares."""
        found = {}
        for i, sign, name in self.settings:
            declared = self._declared[name]
            found[name] = _KINDS[declared["type"]](min(max(sign * values[i], declared["min"]), declared["max"]))
        return found

    def has(self, values: Mapping[str, Any]) -> bool:
        """Whether {name: value} are in force, as the server itself has said since its start and the newest call."""
        return self._known == self._starts and are_in_force(values, self.values)

    def upper_bound(self, name: str) -> float:
        """The largest value that the server declares for a parameter."""
        return self._declared[name]["max"]

    @property
    def unanswered(self) -> Optional[Future]:
        """The call that the server has still to answer."""
        return None if self._call is None or self._call.done() else self._call

    def set(self, values: Mapping[str, Any]) -> Future:
        """Begin a call, with no other unanswered; its result is what is in force then.

        The answer alone is not believed: every server publishes on parameter_updates what it has then.
        """
        future: Future = Future()
        starts, self._known = self._starts, 0

        def call() -> None:
            try:
                answer = self._client.update_configuration(dict(values))
                until = time.monotonic() + ANNOUNCED
                while any(self.values[name] != answer[name] for name in values) and time.monotonic() < until:
                    time.sleep(0.002)
                if all(self.values[name] == answer[name] for name in values):
                    self._known = starts
                self.refused = not self.has(values)
                future.set_result(self.values)
            except Exception as error:
                self.refused = "responded with an error" in str(error.__context__)  # others found no server
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
        anew = bool(self._declared)  # each server sends it once
        self._starts += 1
        self._declared = {parameter["name"]: parameter for parameter in description}
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
        self.starting = False  # whether the last `connect` found move_base's node, but none of its servers yet
        self._on_restart = on_restart
        self._servers: Dict[str, Server] = {}  # by their names in the space
        self.compensation = Compensation(space)  # what is sent instead of theta, and back
        self._sent: Optional[Tuple[np.ndarray, np.ndarray]] = None  # (theta, values) of the last apply
        self._lock = threading.Lock()  # one apply at a time

    @property
    def connected(self) -> bool:
        """Whether all servers of the space have been found."""
        return len(self._servers) == len(self.space.servers)

    @property
    def servers(self) -> Dict[str, str]:
        """{server as the space names it: its full name as found}."""
        return {wanted: server.name for wanted, server in self._servers.items()}

    def connect(self) -> str:
        """Finds the servers. Returns "" when all are known, else one line saying what is missing."""
        try:
            found = find_reconfigure_services()
            below = [name for name in found if (name + "/").startswith(self.namespace + "/")]
            self.starting = not below and _is_alive(self.namespace)
        except Exception as problem:  # rosservice has errors of its own
            return f"no ROS master: {reason(problem)}"
        for wanted in [wanted for wanted in self.space.servers if wanted not in self._servers]:
            error = f"no parameter server for {wanted or 'move_base'} below {self.namespace}: is move_base up?"
            for name in self._candidates(wanted, found):
                error = self._try(wanted, name)
                if not error:
                    break
            if error:
                return error
        return ""

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
            server = Server(name, self._on_restart)
        except rospy.ROSException as problem:
            return f"{name}: {reason(problem)}"
        error = server.hold(self.space.targets_of(wanted), f"the {wanted or 'move_base'} of a {self.space.robot}")
        if error:
            server.close()
        else:
            self._servers[wanted] = server
        return error

    def values(self) -> Optional[np.ndarray]:
        """(n,) float64: what the planner has, as last heard; of a value that several servers hold, the first counts.

        None before `connect` has succeeded.
        """
        if not self.connected:
            return None
        return np.array([self._servers[server].value(i) for i, (server, _) in enumerate(self.space.places())])

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
        servers = self._servers.values()
        return min((s.upper_bound(name) for s in servers for i, _, name in s.settings if i in indices), default=np.inf)

    def holds(self, values: np.ndarray) -> bool:
        """Whether values (n,) lie within the bounds that the servers declare."""
        return all(
            server.request(values) == {name: sign * values[i] for i, sign, name in server.settings}
            for server in self._servers.values()
        )

    def apply(self, theta: np.ndarray, seconds: float = DEADLINE) -> ApplyReport:
        """Sets theta (n,): one call to each server that has not got its values, side by side, with answers verified.

        What is sent is `compensation`.outgoing(theta), within the servers' bounds. A server whose values are in force
        is left alone: C++ empties a costmap at every call of its server, an unchanged value's, too.

        Raises ApplrError before anything is sent when a value is not finite. Otherwise never raises and ends within
        `seconds` (twice that where values have to be put back): see ApplyReport. If one server refuses, is gone or
        does not answer, those that took the new values get their former ones back. Nothing is sent while a server
        still has a former call to answer.
        """
        theta = self.space.clip(theta)
        until = time.monotonic() + seconds
        with self._lock:
            if not self.connected:
                return ApplyReport(f"no parameter servers below {self.namespace} yet")
            servers = list(self._servers.values())
            wait([server.unanswered for server in servers if server.unanswered], seconds)
            errors = {server: f"{server.name} does not answer" for server in servers if server.unanswered}
            put_back: List[str] = []
            refused = False
            if not errors:
                values = self.compensation.outgoing(theta)
                self._sent = theta, values
                wanted = {server: server.request(values) for server in servers}
                wanted = {server: request for server, request in wanted.items() if not server.has(request)}
                former = {server: {name: server.values[name] for name in wanted[server]} for server in wanted}
                errors = _set_all(wanted, until - time.monotonic())
                refused = any(server.refused for server in errors if not server.unanswered)
                if errors:
                    again = {server: former[server] for server in wanted if not server.unanswered}
                    failed = _set_all(again, seconds)
                    put_back = [server.name for server in again if server not in failed]
            unanswered = tuple(server.name for server in servers if server.unanswered)
        return ApplyReport("; ".join(errors.values()), refused, tuple(put_back), unanswered)

    def close(self) -> None:
        """Unsubscribe from all servers."""
        for server in self._servers.values():
            server.close()


def _is_alive(node: str) -> bool:
    """Whether a node of this name answers; one that was killed may still be registered."""
    code, _, uri = rospy.get_master().lookupNode(node)
    try:
        return code == 1 and rospy.core.xmlrpcapi(uri).getPid(rospy.get_name())[0] == 1
    except OSError:
        return False


def _set_all(requests: Mapping[Server, Mapping[str, Any]], seconds: float) -> Dict[Server, str]:
    """{server: {name: value}} set side by side. Returns {server: why not} of those that failed."""
    calls = {server: server.set(values) for server, values in requests.items()}
    wait(calls.values(), seconds)
    problems = {server: server.problem(call, requests[server]) for server, call in calls.items()}
    return {server: problem for server, problem in problems.items() if problem}
