"""Sets the parameters of a space in a running move_base, ours or the C++ one, all or none.

The applr node's worker calls `apply`; the node reads `theta()`, what the planner really has. Only what every
dynamic_reconfigure server offers is used: the topics parameter_descriptions and parameter_updates (both latched)
and the service set_parameters. Which names, bounds and layers exist is found out, not assumed.
"""

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import rosgraph
import rospy
from dynamic_reconfigure.msg import (
    BoolParameter,
    Config,
    ConfigDescription,
    DoubleParameter,
    IntParameter,
    StrParameter,
)
from dynamic_reconfigure.srv import Reconfigure, ReconfigureRequest

from applr_ros1.nodes.service_call import Deadline, Master, ServiceCaller, ServiceError
from applr_ros1.policy.distance_weights import Compensation
from applr_ros1.policy.parameter_space import SPACE

DEADLINE = 1.0  # s of wall time for one call of all servers
_KINDS = {
    "bools": (BoolParameter, bool),
    "ints": (IntParameter, lambda v: int(np.rint(v))),
    "doubles": (DoubleParameter, float),
    "strs": (StrParameter, str),
}


@dataclass
class ApplyReport:
    """What came of one `apply`.

    ok: every value is in force, read back; theta: (n,) asked for; error: one line; put_back: servers returned to their
    former values; uncertain: servers that may still carry it out; seconds: wall time it took.
    """

    ok: bool
    theta: np.ndarray
    error: str = ""
    put_back: tuple = ()
    uncertain: tuple = ()
    seconds: float = 0.0


class Server:
    """One dynamic_reconfigure server: its values as last heard, its bounds, and a call to change it."""

    def __init__(self, name, master, on_restart=None):
        self.name = name
        self.uncertain = False
        self._caller = ServiceCaller(name + "/set_parameters", Reconfigure, master)
        self._on_restart = on_restart
        self._lock = threading.Lock()
        self._heard = threading.Condition(self._lock)
        self._values, self._kinds, self._low, self._high = {}, {}, {}, {}
        self._connection = None
        self._subscribers = (
            rospy.Subscriber(name + "/parameter_descriptions", ConfigDescription, self._on_description),
            rospy.Subscriber(name + "/parameter_updates", Config, self._on_update),
        )

    def close(self):
        """Unsubscribe from the server's topics."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def wait(self, seconds):
        """Waits until values and bounds are known; False when they are not within `seconds` of wall time."""
        with self._heard:
            return self._heard.wait_for(lambda: self._kinds and self._values, seconds)

    def values(self):
        """{name: value} as last heard."""
        with self._lock:
            return dict(self._values)

    def knows(self, name):
        """Whether the server has a parameter of that name."""
        with self._lock:
            return name in self._kinds

    def clamp(self, name, value):
        """`value` inside the bounds and as the type that the server declares; None for a name that it lacks."""
        with self._lock:
            if name not in self._kinds:
                return None
            value = min(max(value, self._low.get(name, value)), self._high.get(name, value))
            return _KINDS[self._kinds[name]][1](value)

    def upper_bound(self, name):
        """The largest value that the server declares for a parameter; inf where it declares none."""
        with self._lock:
            return self._high.get(name, np.inf)

    def set(self, values, deadline):
        """One set_parameters call. Returns (values in force, names that are not as asked). Raises ServiceError."""
        request = ReconfigureRequest()
        for name, value in values.items():
            getattr(request.config, self._kinds[name]).append(_KINDS[self._kinds[name]][0](name, value))
        response = self._caller.call(request, deadline)
        got = decode(response.config)
        with self._lock:
            self._values.update(got)
        return got, [name for name, value in values.items() if got.get(name) != value]

    def _on_description(self, msg):
        with self._heard:
            self._kinds = {p.name: kind for kind in _KINDS for p in getattr(msg.dflt, kind)}
            self._low, self._high = _numbers(msg.min), _numbers(msg.max)
            self._heard.notify_all()

    def _on_update(self, msg):
        # Messages that came over one connection share one header object: another object is another connection,
        # that is, the latched values of a server that was started anew.
        connection = getattr(msg, "_connection_header", None)
        with self._heard:
            anew = self._connection is not None and connection is not self._connection
            self._connection = connection
            self._values.update(decode(msg))
            self._heard.notify_all()
        if anew and self._on_restart is not None:
            self._on_restart(self)


class ReconfigureClient:
    """The parameters of one move_base.

    namespace: of move_base. space: which parameters, and the servers that hold them. on_restart(server): called when a
    server came back after a restart, from a callback's thread. Make it after rospy.init_node.
    """

    def __init__(self, namespace="/move_base", space=SPACE, on_restart=None):
        self.namespace, self.space = namespace.rstrip("/"), space
        self.master = Master(rosgraph.get_master_uri(), rospy.get_name())
        self._on_restart = on_restart
        self._servers = {}  # server as the space names it -> Server
        self._names = {}  # the same -> [(index in theta, sign, name)]
        self.compensation = Compensation(space)  # what is sent instead of theta, and back
        self._sent = None  # (theta, values) of the last apply
        self._pool = ThreadPoolExecutor(max(3, len(space.servers)), thread_name_prefix="reconfigure")
        self._lock = threading.Lock()  # one apply at a time

    @property
    def connected(self):
        """Whether all servers of the space have been found."""
        return len(self._names) == len(self.space.servers)

    @property
    def servers(self):
        """{server as the space names it: its full name as found}."""
        return {wanted: server.name for wanted, server in self._servers.items()}

    def connect(self, seconds=3.0):
        """Finds the servers. Returns "" when all are known, else one line saying what is missing."""
        deadline = Deadline(seconds)
        try:
            services = self.master.call("getSystemState", deadline=deadline)[2]
        except ServiceError as e:
            return str(e)
        tail = "/set_parameters"
        found = [name[: -len(tail)] for name, _ in services if name.endswith(tail)]
        for wanted in self.space.servers:
            if wanted in self._names:
                continue
            error = f"no parameter server for {wanted or 'move_base'} below {self.namespace}: is move_base up?"
            for name in self._candidates(wanted, found):
                error = self._try(wanted, name, deadline)
                if not error:
                    break
            if error:
                return error
        return ""

    def is_move_base_starting(self, seconds=1.0):
        """Whether a node of move_base's name lives and has no parameter server yet: it may be compiling its kernels."""
        deadline = Deadline(seconds)
        try:
            services = self.master.call("getSystemState", deadline=deadline)[2]
            if any(self.namespace in nodes and name.endswith("/set_parameters") for name, nodes in services):
                return False
            uri = self.master.call("lookupNode", self.namespace, deadline=deadline)
            Master(uri, self.master.caller_id).call("getPid", deadline=deadline)
        except (ServiceError, OSError):
            return False
        return True

    def _candidates(self, wanted, found):
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

        def alike(name):
            return len(os.path.commonprefix([name.rpartition("/")[2].lower(), last.lower()]))

        return sorted(there, key=lambda name: (-alike(name), name))

    def _try(self, wanted, name, deadline):
        """Takes server `name` for `wanted` if it has the parameters. Returns "" or one line why not."""
        server = Server(name, self.master, self._on_restart)
        try:
            known = server.wait(max(0.0, min(1.0, deadline.at - time.monotonic())))
            names, missing = [], []
            for i, target in self.space.targets_of(wanted):
                chosen = next((n for n in target.names if server.knows(n)), None)
                (names.append((i, target.sign, chosen)) if chosen else missing.append(target.names[0]))
            if not known:
                return f"{name} does not publish its parameters: is it stopped?"
            if missing:
                return (
                    f"{name} has no parameter {missing[0]}: the {wanted or 'move_base'} of a {self.space.robot} has it"
                )
            self._servers[wanted], self._names[wanted] = server, names
            return ""
        finally:
            if self._servers.get(wanted) is not server:
                server.close()

    def values(self):
        """(n,) float64: what the planner has, as last heard; of a value that several servers hold, the first counts.

        None before `connect` has succeeded.
        """
        if not self.connected:
            return None
        values = {wanted: server.values() for wanted, server in self._servers.items()}
        return np.array([values[server][self._name(i, server)] for i, (server, _) in enumerate(self.space.places())])

    def _name(self, index, wanted):
        """What the server `wanted` calls the parameter with this index in theta."""
        return next(name for i, sign, name in self._names[wanted] if i == index and sign > 0)

    def theta(self):
        """(n,) float64: what the planner's values mean as a parameter set; None before `connect` has succeeded."""
        values, sent = self.values(), self._sent
        if values is None:
            return None
        if sent is not None and np.array_equal(values, sent[1]):
            return sent[0].copy()
        return self.compensation.incoming(values)

    def upper_bound(self, *indices):
        """The smallest upper bound that the servers declare for these parameters of theta; inf for none."""
        names = [(server, name) for server in self._names for i, _, name in self._names[server] if i in indices]
        return min((self._servers[server].upper_bound(name) for server, name in names), default=np.inf)

    def holds(self, values):
        """Whether values (n,) lie within the bounds that the servers declare."""
        return all(
            self._servers[server].clamp(name, sign * values[i]) == sign * values[i]
            for server, names in self._names.items()
            for i, sign, name in names
        )

    def apply(self, theta, seconds=DEADLINE):
        """Sets theta (n,) on all servers, one call each and side by side, and verifies the answers.

        What is sent is `compensation`.outgoing(theta), within the servers' bounds.

        Raises SpaceError before anything is sent when a value is not finite. Otherwise never raises and ends within
        `seconds` (twice that where values have to be put back): see ApplyReport. If one server refuses, is gone or
        does not answer, those that took the new values get their former ones back.
        """
        theta = self.space.clip(theta)
        began = time.monotonic()
        with self._lock:
            if not self.connected:
                return ApplyReport(False, theta, f"no parameter servers below {self.namespace} yet")
            values = self.compensation.outgoing(theta)
            self._sent = theta, values
            requests = {
                wanted: {name: self._servers[wanted].clamp(name, sign * values[i]) for i, sign, name in names}
                for wanted, names in self._names.items()
            }
            former = {wanted: self._servers[wanted].values() for wanted in requests}
            errors = self._set_all(requests, Deadline(seconds))
            put_back = ()
            if errors:
                again = {
                    wanted: {name: former[wanted][name] for name in requests[wanted]}
                    for wanted in requests
                    if wanted not in errors or errors[wanted].answered
                }
                failed = self._set_all(again, Deadline(seconds))
                put_back = tuple(self._servers[wanted].name for wanted in again if wanted not in failed)
        return ApplyReport(
            not errors,
            theta,
            "; ".join(str(e) for e in errors.values()),
            put_back,
            tuple(s.name for s in self._servers.values() if s.uncertain),
            time.monotonic() - began,
        )

    def _set_all(self, requests, deadline):
        """{server: {name: value}} set side by side. Returns {server: ServiceError} of those that failed."""
        futures = {
            wanted: self._pool.submit(self._set, wanted, values, deadline) for wanted, values in requests.items()
        }
        results = {wanted: future.result() for wanted, future in futures.items()}
        return {wanted: error for wanted, error in results.items() if error}

    def _set(self, wanted, values, deadline):
        server = self._servers[wanted]
        try:
            got, other = server.set(values, deadline)
        except ServiceError as e:
            server.uncertain |= e.uncertain
            return e
        server.uncertain = False
        if other:
            name = other[0]
            return ServiceError(f"{server.name} holds {name} at {got.get(name)}, not {values[name]}", answered=True)
        return None

    def close(self):
        """Unsubscribe from all servers and end the threads."""
        for server in self._servers.values():
            server.close()
        self._pool.shutdown(wait=False)


def decode(config):
    """{name: value} of a dynamic_reconfigure Config message."""
    return {p.name: p.value for kind in _KINDS for p in getattr(config, kind)}


def _numbers(config):
    return {p.name: p.value for kind in ("ints", "doubles") for p in getattr(config, kind)}
