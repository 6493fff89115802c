"""Sets the eight parameters of a running TrajectoryPlannerROS move_base, ours or the C++ one, all or none.

The applr node's worker calls `apply`; the node reads `theta()`, what the planner really has. Only what every
dynamic_reconfigure server offers is used: the topics parameter_descriptions and parameter_updates (both latched)
and the service set_parameters. Which names, bounds and layers exist is found out, not assumed.
"""

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
from applr_ros1.policy.parameter_space import ROLES, SPACE

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

    ok: every value is in force, read back; theta: (8,) asked for; error: one line; put_back: servers returned to their
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

    namespace: of move_base. on_restart(server): called when a server came back after a restart, from a callback's
    thread. Make it after rospy.init_node.
    """

    def __init__(self, namespace="/move_base", space=SPACE, on_restart=None):
        self.namespace, self.space = namespace.rstrip("/"), space
        self.master = Master(rosgraph.get_master_uri(), rospy.get_name())
        self._on_restart = on_restart
        self._servers = {}  # role -> Server
        self._names = {}  # role -> [(index in theta, sign, name)]
        self.compensation = Compensation()  # what is sent instead of theta, and back
        self._sent = None  # (theta, values) of the last apply
        self._pool = ThreadPoolExecutor(3, thread_name_prefix="reconfigure")
        self._lock = threading.Lock()  # one apply at a time

    @property
    def connected(self):
        """Whether all three servers have been found."""
        return len(self._names) == len(ROLES)

    @property
    def servers(self):
        """{role: full server name} as found."""
        return {role: server.name for role, server in self._servers.items()}

    def connect(self, seconds=3.0):
        """Finds the servers. Returns "" when all are known, else one line saying what is missing."""
        deadline = Deadline(seconds)
        try:
            services = self.master.call("getSystemState", deadline=deadline)[2]
        except ServiceError as e:
            return str(e)
        tail = "/set_parameters"
        found = [name[: -len(tail)] for name, _ in services if name.endswith(tail)]
        for role, candidates in self._candidates(found).items():
            if role in self._names:
                continue
            error = f"no parameter server for {role} below {self.namespace}: is move_base up?"
            for name in candidates:
                error = self._try(role, name, deadline)
                if not error:
                    break
            if error:
                return error
        return ""

    def _candidates(self, found):
        """{role: [server names, likeliest first]}. The C++ costmap names its layers freely."""

        def below(prefix, likely):
            names = [n for n in found if n.startswith(prefix) and "/" not in n[len(prefix) :]]
            return sorted(names, key=lambda n: (likely not in n[len(prefix) :].lower(), n))

        planners = [n for n in below(self.namespace + "/", "trajectoryplanner") if not n.endswith("_costmap")]
        return {
            "planner": planners,
            "local_inflation": below(self.namespace + "/local_costmap/", "inflat"),
            "global_inflation": below(self.namespace + "/global_costmap/", "inflat"),
        }

    def _try(self, role, name, deadline):
        """Takes server `name` for `role` if it has the parameters. Returns "" or one line why not."""
        server = Server(name, self.master, self._on_restart)
        try:
            known = server.wait(max(0.0, min(1.0, deadline.at - time.monotonic())))
            names, missing = [], []
            for i, target in self.space.targets_of(role):
                chosen = next((n for n in target.names if server.knows(n)), None)
                (names.append((i, target.sign, chosen)) if chosen else missing.append(target.names[0]))
            if not known:
                return f"{name} does not publish its parameters: is it stopped?"
            if missing:
                return f"{name} has no parameter {missing[0]}: a TrajectoryPlannerROS move_base is needed"
            self._servers[role], self._names[role] = server, names
            return ""
        finally:
            if self._servers.get(role) is not server:
                server.close()

    def values(self):
        """(8,) float64: what the planner has, as last heard (inflation: the local costmap's).

        None before `connect` has succeeded.
        """
        if not self.connected:
            return None
        found = np.array(self.space.theta0)
        for role in reversed(tuple(ROLES)):  # of the two costmaps, the local one counts
            values = self._servers[role].values()
            for i, sign, name in self._names[role]:
                if sign > 0:
                    found[i] = values[name]
        return found

    def theta(self):
        """(8,) float64: what the planner's values mean as a parameter set; None before `connect` has succeeded."""
        values, sent = self.values(), self._sent
        if values is None:
            return None
        if sent is not None and np.array_equal(values, sent[1]):
            return sent[0].copy()
        return self.compensation.incoming(values)

    def upper_bound(self, *indices):
        """The smallest upper bound that the servers declare for these parameters of theta; inf for none."""
        names = [(role, name) for role in self._names for i, sign, name in self._names[role] if i in indices]
        return min((self._servers[role].upper_bound(name) for role, name in names), default=np.inf)

    def holds(self, values):
        """Whether values (8,) lie within the bounds that the servers declare."""
        return all(
            self._servers[role].clamp(name, sign * values[i]) == sign * values[i]
            for role, names in self._names.items()
            for i, sign, name in names
        )

    def apply(self, theta, seconds=DEADLINE):
        """Sets theta (8,) on all servers, one call each and side by side, and verifies the answers.

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
            wanted = {
                role: {name: self._servers[role].clamp(name, sign * values[i]) for i, sign, name in names}
                for role, names in self._names.items()
            }
            former = {role: self._servers[role].values() for role in wanted}
            errors = self._set_all(wanted, Deadline(seconds))
            put_back = ()
            if errors:
                again = {
                    role: {name: former[role][name] for name in wanted[role]}
                    for role in wanted
                    if role not in errors or errors[role].answered
                }
                failed = self._set_all(again, Deadline(seconds))
                put_back = tuple(self._servers[role].name for role in again if role not in failed)
        return ApplyReport(
            not errors,
            theta,
            "; ".join(str(e) for e in errors.values()),
            put_back,
            tuple(s.name for s in self._servers.values() if s.uncertain),
            time.monotonic() - began,
        )

    def _set_all(self, wanted, deadline):
        """{role: {name: value}} set side by side. Returns {role: ServiceError} of those that failed."""
        futures = {role: self._pool.submit(self._set, role, values, deadline) for role, values in wanted.items()}
        results = {role: future.result() for role, future in futures.items()}
        return {role: error for role, error in results.items() if error}

    def _set(self, role, values, deadline):
        server = self._servers[role]
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
