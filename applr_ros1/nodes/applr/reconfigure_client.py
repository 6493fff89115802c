"""Client of the parameters of a space in a running move_base, ours or the C++ one: all are set, or none.

The applr node says what it wants with `request`, which never waits, and reads `theta()`, what the planner really has.
Each server has a client of dynamic_reconfigure's own library. Which names, bounds and layers exist is found out, not
assumed.
"""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import rospy
from dynamic_reconfigure import find_reconfigure_services
from dynamic_reconfigure.client import Client

from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.policy.parameter_space import SPACE, Space, are_in_force
from applr_ros1.robots.robot import Setting

DEADLINE_S = 1.0  # for one call of all servers; see Deadline
SLOWEST = 10.0  # times as much wall time as a deadline, after which it is over however slowly the clock of ROS goes
POLL_S = 0.05
ANNOUNCED_S = 0.4  # between a server's answer and its message on parameter_updates
RETRY_S = 0.25  # between attempts
START_S = 0.5  # longest time between a server's reading of its ROS parameters and its first answer
REFUSALS = 3  # attempts at a set that a server refuses; the next decision brings another set
MOST_SEARCHES = 15  # failed searches for the servers, a second apart, before they are reported
# no texts: for one, the library evaluates as Python what the server says of its choices (edit_method)
_KINDS: Dict[str, Callable[[Any], Any]] = {"bool": bool, "int": lambda v: int(np.rint(v)), "double": float}


class Deadline:
    """An end of waiting: so many seconds by the clock of ROS, by which servers live, and by the wall's, too.

    C++ answers only when the update of its costmap is over, which sleeps by the clock of ROS. Where that one stands
    still, and while the node shuts down, the wall's decides.

    Args:
        seconds: From now on.
    """

    def __init__(self, seconds: float):
        self._seconds, self._wall, self._ros = seconds, time.monotonic(), rospy.get_time()

    @property
    def is_over(self) -> bool:
        """True from the end on."""
        wall, ros = time.monotonic() - self._wall, rospy.get_time() - self._ros
        late = rospy.core.is_shutdown_requested() or wall >= SLOWEST * self._seconds
        return wall >= self._seconds and (ros >= self._seconds or late)

    def wait(self, calls: Iterable[Future]) -> None:
        """Wait until all calls are answered, or to the end."""
        pending = set(calls)
        while pending and not self.is_over:
            _, pending = wait(pending, POLL_S)


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
        """True where every value is in force."""
        return not self.error


class Server:
    """One dynamic_reconfigure server: its values as last heard, its bounds, and calls to change it.

    A stopped process accepts a call and never answers, and the library has no time-out for that. So each call has a
    thread, and there is no second one before it has ended: a late call never undoes a newer one.

    Args:
        name: Its full name.
        targets: (index in theta, Setting) of the values that it must hold.
        on_restart: Called with this server when it came back after a restart.

    Attributes:
        settings: (index in theta, sign, name) of each of those values.
        call: The newest one.
        refused: Whether it was answered, and the values are not in force.

    Raises rospy.ROSException where it does not answer, ApplrError where it does not hold a value.
    """

    def __init__(self, name: str, targets: Sequence[Tuple[int, Setting]], on_restart: Callable[[Server], None]):
        self.name, self._on_restart, self.refused = name, on_restart, False
        self.call: Future = Future()
        self.call.set_result("")
        self._starts = 0  # of the server, as far as they were noticed
        self._known = 1  # its start since which the values are known; 0: a call has shown nothing of them
        self._updates = 0  # how often it published values
        self._client = Client(name, DEADLINE_S, self._on_update, self._on_description)
        self.close = self._client.close
        try:
            for hear in (self._client.get_parameter_descriptions, self._client.get_configuration):
                if hear(DEADLINE_S) is None:
                    raise rospy.ROSException("does not publish its parameters: is it stopped?")
            self.settings = [(i, target.sign, self._name_of(target)) for i, target in targets]
        except Exception:
            self.close()
            raise

    def _name_of(self, target: Setting) -> str:
        for name in target.names:
            if name in self.declared:
                if self.declared[name]["type"] not in _KINDS:
                    raise ApplrError(f"declares {name} as {self.declared[name]['type']}, not as a number")
                return name
        raise ApplrError(f"has no parameter {target.names[0]}")

    def _on_update(self, values: Mapping[str, Any]) -> None:
        self._updates += 1

    def _on_description(self, description: List[Dict[str, Any]]) -> None:
        self._starts += 1  # each server sends it once
        if self._starts > 1:
            self._on_restart(self)

    @property
    def declared(self) -> Dict[str, Dict[str, Any]]:
        """{name: {"type", "min", "max", ...}} of its parameters."""
        return {parameter["name"]: parameter for parameter in self._client.param_description}

    @property
    def values(self) -> Mapping[str, Any]:
        """{name: value} as last heard."""
        return self._client.config

    def has(self, values: Mapping[str, Any]) -> bool:
        """Return whether {name: value} are in force, by what the server said since its start and newest call."""
        return self._known == self._starts and are_in_force(values, self.values)

    def request(self, values: np.ndarray) -> Dict[str, Any]:
        """{name: value} of what it holds of values (n,), as the types that it declares."""
        declared = self.declared
        return {name: _KINDS[declared[name]["type"]](sign * values[i]) for i, sign, name in self.settings}

    def set(self, values: Mapping[str, Any]) -> Future:
        """Begin a call, with no other unanswered; its result is one line why {name: value} are not in force, or ""."""
        self.call, self.refused = Future(), False
        threading.Thread(target=self._set, args=(dict(values), self.call), daemon=True).start()
        return self.call

    def _set(self, values: Dict[str, Any], call: Future) -> None:
        """The answer alone is not believed: every server publishes on parameter_updates what it has then."""
        starts, updates, self._known = self._starts, self._updates, 0
        try:
            answer, until = self._client.update_configuration(dict(values)), Deadline(ANNOUNCED_S)
            answer = {name: answer[name] for name in values}
            while not are_in_force(answer, self.values) and not until.is_over:
                time.sleep(0.002)
            has = {name: self.values[name] for name in values}
            self._known = starts if has == answer else 0
            other = next((name for name in values if has[name] != values[name]), None)
            error = "" if other is None else f"{self.name} holds {other} at {has[other]}, not {values[other]}"
            # who answers as asked and publishes nothing is not heard yet, after a restart or on a busy machine
            self.refused = bool(error) and (answer != values or self._updates != updates)
        except Exception as problem:  # the library hides what the server said behind an error of its own
            answer = problem.__context__ if isinstance(problem.__context__, rospy.ServiceException) else problem
            error = f"{self.name}: {reason(answer)}"
            self.refused = "responded with an error" in str(answer)  # rospy's words; others reached no server
        call.set_result(error)


class ReconfigureClient:
    """The parameters of one move_base, and the only door to them. Make it after rospy.init_node.

    `apply` waits for its result; once it is started, a thread applies what is requested, until it is in force. Both
    clip to the space's ranges, round counts, and refuse what is not finite.

    Args:
        namespace: Of move_base.
        space: Which parameters, and the servers that hold them.
        on_restart: Called with a Server that came back after a restart, from a callback's thread.
        on_report: Called with the ApplyReport of every attempt at a request, from the client's thread.
        on_trouble: Called from there with one line while the servers cannot be found, and with "" when they have been.

    Attributes:
        applied: theta (n,) of the last request that came into force.
        multipliers: (n,) by which parameters are multiplied on their way to the planner (MeterScoring sets them).
    """

    def __init__(
        self,
        namespace: str = "/move_base",
        space: Space = SPACE,
        on_restart: Callable[[Server], None] = lambda server: None,
        on_report: Callable[[ApplyReport], None] = lambda report: None,
        on_trouble: Callable[[str], None] = lambda line: None,
    ):
        self.namespace, self.space = namespace.rstrip("/"), space
        self._on_restart, self._on_report, self._on_trouble = on_restart, on_report, on_trouble
        self.applied: Optional[np.ndarray] = None
        self._requested: Optional[np.ndarray] = None  # theta (n,) that is not in force yet
        self._refusals = 0
        self._stopped = False
        self._asking, self._wake = threading.RLock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="reconfigure_client", daemon=True)
        self.starting = False  # whether the last `connect` found move_base's node, but none of its servers yet
        self._servers: Dict[str, Server] = {}  # by their names in the space
        self.multipliers = np.ones(len(space))
        self._sent: Optional[Tuple[np.ndarray, np.ndarray]] = None  # (theta, values) of the last apply
        self._lock = threading.Lock()  # one apply at a time

    @property
    def connected(self) -> bool:
        """True once all servers of the space have been found."""
        return len(self._servers) == len(self.space.servers)

    @property
    def sent(self) -> Optional[np.ndarray]:
        """Theta (n,) of the last apply, of which servers may have a part; None before the first one."""
        return None if self._sent is None else self._sent[0]

    @property
    def servers(self) -> Dict[str, str]:
        """{server as the space names it: its full name as found}."""
        return {wanted: server.name for wanted, server in self._servers.items()}

    def connect(self) -> str:
        """Find the servers. Returns "" when all are known, else one line saying what is missing."""
        try:
            found = find_reconfigure_services()
            below = [name for name in found if (name + "/").startswith(self.namespace + "/")]
            self.starting = not below and _is_alive(self.namespace)
        except Exception as problem:  # rosservice has errors of its own
            return f"no ROS master: {reason(problem)}"
        for wanted in [wanted for wanted in self.space.servers if wanted not in self._servers]:
            error = f"no parameter server for {wanted or 'move_base'} below {self.namespace}: is move_base up?"
            for name in self._candidates(wanted, found):
                try:
                    self._servers[wanted] = Server(name, self.space.targets_of(wanted), self._on_restart)
                    break
                except rospy.ROSException as problem:
                    error = f"{name}: {reason(problem)}"
                except ApplrError as problem:
                    error = f"{name} {problem}: the {wanted or 'move_base'} of a {self.space.robot} has it"
            else:
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

    def values(self) -> Optional[np.ndarray]:
        """(n,) float64: what the planner has, as last heard; of a value that several servers hold, the first counts.

        None before `connect` has succeeded, and where a server has last said no number.
        """
        if not self.connected:
            return None
        found = np.empty(len(self.space))
        for i, (server, _) in enumerate(self.space.places()):
            has = self._servers[server]
            name = next(name for j, sign, name in has.settings if j == i and sign > 0)
            if not isinstance(has.values.get(name), (bool, int, float)):
                return None
            found[i] = has.values[name]
        return found

    def theta(self) -> Optional[np.ndarray]:
        """(n,) float64: what the planner's values mean as a parameter set; None before `connect` has succeeded."""
        values, sent = self.values(), self._sent
        if values is None:
            return None
        if sent is not None and np.array_equal(values, sent[1]):
            return sent[0].copy()
        return values / self.multipliers

    def bounds(self) -> Tuple[np.ndarray, np.ndarray]:
        """The smallest and the largest values (n,) that all servers take."""
        low, high = np.full((2, len(self.space)), [[-np.inf], [np.inf]])
        for server in self._servers.values():
            declared = server.declared
            for i, sign, name in server.settings:
                least, most = sorted(sign * declared[name][end] for end in ("min", "max"))
                low[i], high[i] = max(low[i], least), min(high[i], most)
        return low, high

    def apply(self, theta: np.ndarray, seconds: float = DEADLINE_S, all_or_none: bool = True) -> ApplyReport:
        """Set theta (n,): one call to each server that has not got its values, side by side, with answers verified.

        What is sent is theta times `multipliers`, within the servers' bounds. A server whose values are in force is
        left alone: C++ empties a costmap at every call of its server, an unchanged value's, too.

        Raises ApplrError before anything is sent when a value is not finite. Otherwise never raises and ends within
        `seconds` (twice that where values have to be put back), as Deadline counts them: see ApplyReport. If one server
        refuses, is gone or does not answer, with all_or_none those that took the new values get their former ones
        back, and nothing is sent while a server still has a former call to answer.
        """
        return self._apply(self.space.clip(theta), seconds, all_or_none)

    def _apply(self, theta: np.ndarray, seconds: float = DEADLINE_S, all_or_none: bool = True) -> ApplyReport:
        until = Deadline(seconds)
        with self._lock:
            if not self.connected:
                return ApplyReport(f"no parameter servers below {self.namespace} yet")
            servers = list(self._servers.values())
            until.wait(server.call for server in servers)
            errors = {server: f"{server.name} does not answer" for server in servers if not server.call.done()}
            put_back: List[str] = []
            refused = False
            if not errors or not all_or_none:
                wanted = {s: request for s, request in self._requests(theta).items() if s not in errors}
                wanted = {server: request for server, request in wanted.items() if not server.has(request)}
                former = {s: {name: s.values[name] for name in wanted[s] if name in s.values} for s in wanted}
                errors.update(_set_all(wanted, until))
                refused = any(server.refused for server in errors)
                if errors and all_or_none:
                    again = {server: former[server] for server in wanted if server.call.done()}
                    failed = _set_all(again, Deadline(seconds))
                    put_back = [server.name for server in again if server not in failed]
            unanswered = tuple(server.name for server in servers if not server.call.done())
        return ApplyReport("; ".join(errors.values()), refused, tuple(put_back), unanswered)

    def _requests(self, theta: np.ndarray) -> Dict[Server, Dict[str, Any]]:
        """{server: {name: value}} of theta (n,), which counts as sent from now on."""
        self._sent = theta, theta * self.multipliers
        values = np.clip(self._sent[1], *self.bounds())
        return {server: server.request(values) for server in self._servers.values()}

    def leave(self, theta: np.ndarray) -> None:
        """Set theta (n,) at the end of the node, with servers that are starting or down, too: call `stop` before.

        A server starts with the ROS parameters, in which every change was kept. Where one is not reached, theta is
        written there, and again with further attempts, until what had read it before must have answered.
        """
        until, report = Deadline(START_S), self.apply(theta, all_or_none=False)
        while not report.ok and self.connected:
            with suppress(OSError):  # of a master that is gone, and its parameters with it, or frozen (init_node)
                for server, request in self._requests(self.space.clip(theta)).items():
                    for name, value in request.items():
                        rospy.set_param(f"{server.name}/{name}", value)
            report = self.apply(theta, all_or_none=False)
            if until.is_over:
                break
            time.sleep(RETRY_S)

    def start(self) -> None:
        """Begin to apply requests; those made before are kept."""
        self._thread.start()

    def request(self, theta: np.ndarray) -> np.ndarray:
        """Have theta (n,) applied as soon as possible, instead of what was requested before; returns it as requested.

        Raises ApplrError, and changes nothing, for a value that is not finite.
        """
        theta = self.space.clip(theta)
        with self._asking:
            self._requested, self._refusals = theta, 0
        self._wake.set()
        return theta

    def reapply(self) -> None:
        """Apply the present parameters anew: a server came back and has its start-up values."""
        with self._asking:
            present = self.applied if self._requested is None else self._requested
            if present is not None:
                self.request(present)  # an attempt that is under way may have reached the server before

    @property
    def busy(self) -> bool:
        """True while a request is not in force."""
        return self._requested is not None

    def stop(self) -> None:
        """End the thread; what is still requested is dropped."""
        self._stopped = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2 * DEADLINE_S + 0.1)  # an attempt that is under way takes no longer

    def close(self) -> None:
        """End the thread and unsubscribe from all servers."""
        self.stop()
        for server in self._servers.values():
            server.close()

    def _run(self) -> None:
        failures = 0
        while not self._stopped:
            pause, theta = 4 * RETRY_S, self._requested
            try:
                if self.connected:
                    if theta is not None:
                        self._attempt(theta)
                        pause = RETRY_S
                else:
                    trouble = self.connect()
                    failures = 0 if self.starting else failures + 1
                    if not trouble or failures >= MOST_SEARCHES:
                        self._on_trouble(trouble)
                    pause = pause if trouble else 0.0
            except Exception as e:  # whatever it is, the thread that talks to the planner goes on
                self._on_trouble(f"parameters not applied ({type(e).__name__}: {e})")
            self._wake.wait(pause)
            self._wake.clear()

    def _attempt(self, theta: np.ndarray) -> None:
        report = self._apply(theta)
        with self._asking:
            if report.ok:
                self.applied = theta
            if theta is self._requested:  # none newer
                self._refusals += report.refused and not report.unanswered
                if report.ok or self._refusals >= REFUSALS:
                    self._requested = None
        self._on_report(report)


def _is_alive(node: str) -> bool:
    """Return whether a node of this name answers; one that was killed may still be registered."""
    code, _, uri = rospy.get_master().lookupNode(node)
    try:
        return code == 1 and rospy.core.xmlrpcapi(uri).getPid(rospy.get_name())[0] == 1
    except OSError:
        return False


def _set_all(requests: Mapping[Server, Mapping[str, Any]], until: Deadline) -> Dict[Server, str]:
    """{server: {name: value}} set side by side. Returns {server: why not} of those that failed."""
    calls = {server: server.set(values) for server, values in requests.items()}
    until.wait(calls.values())
    errors = {s: call.result() if call.done() else f"{s.name} does not answer" for s, call in calls.items()}
    return {server: error for server, error in errors.items() if error}
