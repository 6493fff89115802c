"""Client for the dynamic_reconfigure servers of one move_base, this package's or the C++ one.

The applr node requests Settings, without blocking, and reads the parameters in force with
`theta()`. Names, bounds and layers are those that the servers declare, and the unit of the distance
biases is the planner's.
"""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import Future, wait
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np
import rospy
from dynamic_reconfigure import find_reconfigure_services
from dynamic_reconfigure.client import Client

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.threads import called
from applr_ros1.nodes.applr.distance_weights import multipliers_of
from applr_ros1.planner.parameters.settings import Change, Settings, are_in_force
from applr_ros1.policy.parameter_space import SPACE, Space
from applr_ros1.robots.robot import Target

DEADLINE_S = 1.0  # wall time for one call of all servers [s]
# Wall time for the last call at shutdown [s]; a C++ server drops calls of nodes that have ended
RESTORE_S = 3.0
ANNOUNCED_S = 0.4  # longest time between a server's answer and its message on parameter_updates [s]
RETRY_S = 0.25  # pause between two attempts [s]
SEARCH_S = 1.0  # pause between two searches for the servers [s]
MOST_SEARCHES = 15  # number of failed searches before they are reported


class ServerClient:
    """Client for one dynamic_reconfigure server: latest values, bounds, and calls.

    The server may never answer, so each call has a thread. The next call begins only after it has
    ended, so that a late call never overwrites a newer one.

    Args:
        name: Full name of the server.
        targets: Addresses of the values that the server must have.
        on_restart: Called with this object when the server comes back after a restart.

    Attributes:
        names: {name of a target: name on this server, which may be an older one}.
        call: The latest call. Its result is the reason in one line why the values are not in force,
            or "".

    Raises:
        rospy.ROSException: The server does not answer.
        ApplrError: The server lacks a value.
    """

    def __init__(
        self, name: str, targets: Iterable[Target], on_restart: Callable[[ServerClient], None]
    ):
        self.name = name
        self._on_restart = on_restart
        self._is_described = False
        # Whether the process is new, so that `values` may be from its predecessor
        self._is_restarted = False
        self.call: Future[str] = Future()
        self.call.set_result("")
        client = Client(name, DEADLINE_S, None, self._on_description)
        self._client = client
        self.close = client.close
        try:
            has_descriptions = client.get_parameter_descriptions(DEADLINE_S) is not None
            if not has_descriptions or client.get_configuration(DEADLINE_S) is None:
                raise rospy.ROSException("does not publish its parameters: is it stopped?")
            self.names = {target.name: self._declared_name(target) for target in targets}
        except Exception:
            self.close()  # Otherwise the library would go on listening.
            raise

    def _declared_name(self, target: Target) -> str:
        """Return the name of a value on this server.

        Raises:
            ApplrError: The server does not have it.
        """
        # Servers of older versions of move_base have only older names.
        for name in target.names:
            if name in self.declared:
                return name
        raise ApplrError(f"has no parameter {target.name}")

    def _on_description(self, description: List[Dict[str, Any]]) -> None:
        # Each process sends its description once, so that a second one is from a new process.
        if self._is_described:
            self._is_restarted = True
            self._on_restart(self)
        self._is_described = True

    @property
    def declared(self) -> Dict[str, Dict[str, Any]]:
        """Declarations of the server's parameters, as {name: {"type", "min", "max", ...}}."""
        return {parameter["name"]: parameter for parameter in self._client.param_description}

    @property
    def values(self) -> Mapping[str, Any]:
        """Values {name: value} of the server's latest message."""
        config: Dict[str, Any] = self._client.config
        return config

    def value_of(self, target: Target) -> Any:
        """Return the server's latest value at an address, or None."""
        return self.values.get(self.names[target.name])

    def largest_of(self, target: Target) -> float:
        """Return the largest number of a parameter that the server accepts."""
        # A sign of -1 exchanges the bounds.
        declared = self.declared[self.names[target.name]]
        return float(max(target.signed(declared["min"]), target.signed(declared["max"])))

    def bounded(self, values: Mapping[str, Any]) -> Dict[str, float]:
        """Return {name of a target: value} with this server's names, within its bounds.

        The server would clamp the values itself, but its answer must equal the request. The library
        converts the types.
        """
        declared = self.declared
        request = {}
        for target_name, value in values.items():
            name = self.names[target_name]
            smallest = declared[name]["min"]
            largest = declared[name]["max"]
            request[name] = float(min(max(value, smallest), largest))
        return request

    def has_set(self, request: Mapping[str, Any]) -> bool:
        """Return whether a request's values are in force.

        False until a restarted server has been set.
        """
        return not self._is_restarted and are_in_force(request, self.values)

    def begin_call(self, request: Mapping[str, Any]) -> None:
        """Begin a call that sets a request's values. The former call must have ended."""
        self.call = called(self._set, dict(request))

    def _set(self, request: Dict[str, Any]) -> str:
        """Call the server, and wait for its parameter_updates. Return the result of `call`.

        A server's answer may differ from what it then applies.
        """
        error = ""
        try:
            self._client.update_configuration(dict(request))
            self._is_restarted = False
            deadline = time.monotonic() + ANNOUNCED_S
            while not self.has_set(request) and time.monotonic() < deadline:
                time.sleep(0.002)
            for name, value in request.items():
                if not self.has_set({name: value}):
                    present_value = self.values.get(name)
                    error = f"{self.name}: {name} is {present_value} instead of {value}"
                    break
        except Exception as problem:
            # The library raises an error of its own in place of the server's.
            cause = problem
            if isinstance(problem.__context__, rospy.ServiceException):
                cause = problem.__context__
            error = f"{self.name}: {reason(cause)}"
        return error


class Request(NamedTuple):
    """Settings to be put in force, and whether their distance biases are per costmap cell."""

    settings: Settings
    per_cell: bool


class ReconfigureClient:
    """Client for the parameters of one move_base.

    `apply` puts settings in force and waits for the result. `request` leaves this to the client's
    thread, which retries until they are in force. Both convert settings whose distance biases are
    per cell to the unit in which the planner counts, and bound each value as its server declares.

    Args:
        namespace: Namespace of move_base.
        space: The parameters, and the servers that have them.
        on_restart: Called with the ServerClient of a restarted server, from a callback's thread.
        on_report: Called with the result of every attempt at a request, as `apply` returns it, from
            the client's thread.
        on_trouble: Called from the client's thread with one line while servers are missing, and
            with "" once all are found.

    Attributes:
        servers: Servers found so far, by their names in the space.
        busy: True until the latest request is in force.
        factor: Factor that the planner applies to its distance biases: 1.0 (they are per cell), or
            the resolution of its local costmap [m] (per metre). None until MeterScoring knows it.
    """

    def __init__(
        self,
        namespace: str = "/move_base",
        space: Space = SPACE,
        on_restart: Callable[[ServerClient], None] = lambda server: None,
        on_report: Callable[[str], None] = lambda error: None,
        on_trouble: Callable[[str], None] = lambda line: None,
    ):
        self.namespace = namespace.rstrip("/")
        self.space = space
        self.factor: Optional[float] = None
        self._on_restart = on_restart
        self._on_report = on_report
        self._on_trouble = on_trouble
        self.servers: Dict[str, ServerClient] = {}
        self.busy = False
        self._requested: Optional[Request] = None  # the last request
        self._sent: Optional[Request] = None  # settings of the last apply
        self._applying = threading.Lock()  # allows one apply at a time
        self._requesting = threading.Lock()  # guards _requested and busy
        self._wake = threading.Event()
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, name="reconfigure_client", daemon=True)

    @property
    def connected(self) -> bool:
        """True if all servers of the space have been found."""
        return len(self.servers) == len(self.space.servers)

    @property
    def sent(self) -> Optional[Settings]:
        """Settings of the last apply in the planner's unit, which some servers may have refused.

        None before the first apply.
        """
        if self._sent is None:
            return None
        return self._converted(self._sent)

    def connect(self) -> str:
        """Find the servers.

        Return "" if all are known, otherwise one line about the missing one.
        """
        try:
            running = find_reconfigure_services()
        except Exception as problem:  # rosservice has exceptions of its own.
            return f"no ROS master: {reason(problem)}"
        for wanted_server in self.space.servers:
            if wanted_server not in self.servers:
                trouble = self._connect_server(wanted_server, running)
                if trouble:
                    return trouble
        return ""

    def _connect_server(self, wanted_server: str, running: List[str]) -> str:
        """Find the space's server `wanted_server` among the running ones.

        Return "", or one line if none is suitable.
        """
        label = wanted_server or "move_base"
        trouble = f"no parameter server for {label} below {self.namespace}: is move_base up?"
        targets = [target for _, target in self.space.addresses if target.server == wanted_server]
        for candidate in self._candidates(wanted_server, running):
            try:
                self.servers[wanted_server] = ServerClient(candidate, targets, self._on_restart)
                return ""
            except rospy.ROSException as problem:
                trouble = f"{candidate}: {reason(problem)}"
            except ApplrError as problem:
                trouble = f"{candidate} {problem}, which the {label} of a {self.space.robot} needs"
        return trouble

    def _candidates(self, wanted_server: str, running: List[str]) -> List[str]:
        """Return the running servers that may be the space's `wanted_server`, likeliest first.

        The names of layers depend on move_base's parameter files. Every server in the same
        namespace is therefore a candidate, and those with the longest common prefix come first.
        """
        wanted_name = f"{self.namespace}/{wanted_server}".rstrip("/")
        parent, _, wanted_base = wanted_name.rpartition("/")
        candidates = [name for name in running if name.rpartition("/")[0] == parent]
        if not wanted_server:
            return [name for name in candidates if name == self.namespace]
        if "/" not in wanted_server and not wanted_server.endswith("_costmap"):
            candidates = [name for name in candidates if not name.endswith("_costmap")]

        def likeness(name: str) -> int:
            _, _, base_name = name.rpartition("/")
            return len(os.path.commonprefix([base_name.lower(), wanted_base.lower()]))

        return sorted(candidates, key=lambda name: (-likeness(name), name))

    def values(self) -> Optional[Array]:
        """Return the planner's latest values (n,) float64.

        If several servers have a value, the first counts.

        None before `connect` has succeeded, and while a server's value is not a number.
        """
        if not self.connected:
            return None
        values = []
        for parameter_name in self.space.names:
            target = self.space.targets[parameter_name][0]
            value = self.servers[target.server].value_of(target)
            if not isinstance(value, (bool, int, float)):
                return None
            values.append(value)
        return np.array(values, dtype=np.float64)

    @property
    def multipliers(self) -> Array:
        """Factors (n,) of the parameters of the last apply on their way to the planner.

        They are not 1 if its settings are per cell, but the planner counts per metre.
        """
        return self._multipliers(self._sent is not None and self._sent.per_cell)

    @property
    def is_per_cell(self) -> bool:
        """True if the settings of the last request are per cell."""
        return self._requested is not None and self._requested.per_cell

    def _multipliers(self, per_cell: bool) -> Array:
        """Return the factors (n,) of parameters that are per cell or not."""
        if self.factor is None or not per_cell:
            return np.ones(len(self.space))
        return multipliers_of(self.space, self.factor, self._largest())

    def _converted(self, request: Request) -> Settings:
        """Return settings in the unit in which the planner counts its distance biases."""
        settings, per_cell = request
        if self.factor is None or not per_cell:
            return settings
        multipliers = self._multipliers(per_cell=True)
        changes = []
        for index, target in self.space.addresses:
            value = settings[target.server][target.name]
            scaled_value = value * multipliers[index]
            changes.append(Change(target.server, target.name, value, scaled_value))
        return settings.with_(*changes)

    def theta(self, per_cell: Optional[bool] = None) -> Optional[Array]:
        """Return the parameters (n,) in force. None if `values` is None.

        Args:
            per_cell: Whether the distance biases are to be per cell; None for the unit of the last
                apply.
        """
        values = self.values()
        if values is None:
            return None
        sent = self._sent
        if per_cell is None:
            per_cell = sent is not None and sent.per_cell
        # The quotient of a product may differ from its factor in the last digit.
        if sent is not None and sent.per_cell == per_cell:
            sent_values = self.space.read_back(self._converted(sent))
            if np.array_equal(values, sent_values):
                return self.space.read_back(sent.settings)
        return values / self._multipliers(per_cell)

    def _largest(self) -> Array:
        """Return the largest parameters (n,) that all servers accept."""
        largest = np.full(len(self.space), np.inf)
        for index, target in self.space.addresses:
            largest[index] = min(largest[index], self.servers[target.server].largest_of(target))
        return largest

    def apply(self, settings: Settings, per_cell: bool = False, seconds: float = DEADLINE_S) -> str:
        """Put settings in force, and read the values back.

        The servers are called in parallel. A server whose values are in force already is not
        called, because every call of a costmap's server in C++ clears the costmap.

        Args:
            settings: Values of all servers of the space.
            per_cell: Whether their distance biases are per costmap cell, whatever the planner
                counts in, or in the planner's own unit.
            seconds: Wall time for all answers [s].

        Returns:
            "" if every value is in force, otherwise one line about the servers that refused, are
            gone or did not answer. The other servers have their new values, and the next attempt
            sets the missing ones.
        """
        with self._applying:
            if not self.connected:
                return f"no parameter servers below {self.namespace} yet"
            self._sent = Request(settings, per_cell)

            # Calls of all servers at once, but none beside an earlier call of the same server.
            requests = self._requests(self._sent)
            for server, request in requests:
                if server.call.done() and not server.has_set(request):
                    server.begin_call(request)
            wait([server.call for server, _ in requests], seconds)

            errors = []
            for server, request in requests:
                if not server.call.done():
                    errors.append(f"{server.name} does not answer")
                elif not server.has_set(request):
                    busy_problem = f"{server.name} was busy with an earlier call"
                    errors.append(server.call.result() or busy_problem)
            return "; ".join(errors)

    def _requests(self, request: Request) -> List[Tuple[ServerClient, Dict[str, float]]]:
        """Return the values of each server that put its part of a request in force."""
        requests = []
        for server_name, values in self._converted(request).items():
            server = self.servers[server_name]
            requests.append((server, server.bounded(values)))
        return requests

    def start(self) -> None:
        """Start the thread that applies requests, including an earlier one."""
        self._thread.start()

    def request(self, settings: Settings, per_cell: bool = False) -> None:
        """Queue settings, with biases per cell or not, in place of the former request."""
        with self._requesting:
            self._requested = Request(settings, per_cell)
            self.busy = True
        self._wake.set()

    def reapply(self) -> None:
        """Apply the present request again, for example after the restart of a server."""
        with self._requesting:
            self.busy = self._requested is not None
        self._wake.set()

    def _note_in_force(self) -> None:
        """End the request if all servers have its values, which another one may have replaced."""
        with self._requesting:
            if self._requested is not None:
                requests = self._requests(self._requested)
                self.busy = not all(server.has_set(request) for server, request in requests)

    def stop(self) -> None:
        """End the thread and drop the open request."""
        self._is_stopped = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(DEADLINE_S + 0.1)  # No attempt takes longer.

    def close(self) -> None:
        """End the thread and unsubscribe from all servers."""
        self.stop()
        for server in self.servers.values():
            server.close()

    def _run(self) -> None:
        """Search for the servers, then apply each request until it is in force."""
        search_count = 0
        while not self._is_stopped:
            pause = SEARCH_S
            request = self._requested
            try:
                if not self.connected:
                    trouble = self.connect()
                    search_count += 1
                    # move_base may be started after this node.
                    if not trouble or search_count >= MOST_SEARCHES:
                        self._on_trouble(trouble)
                    if not trouble:
                        pause = 0.0
                elif request is not None and self.busy:
                    pause = RETRY_S
                    error = self.apply(request.settings, request.per_cell)
                    if not error:
                        self._note_in_force()
                    self._on_report(error)
            except Exception as problem:  # The thread must survive any error.
                self._on_trouble(f"parameters not applied ({type(problem).__name__}: {problem})")
            self._wake.wait(pause)
            self._wake.clear()
