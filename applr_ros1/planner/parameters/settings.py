"""Values of move_base's parameters by server and name, and changes of single values.

Parameter spaces, recorded drives, searches and checks all write and compare parameter values with
`Settings`.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any, Dict, Iterable, Iterator, List, Mapping, NamedTuple

from applr_ros1.planner.parameters.declarations import servers
from applr_ros1.planner.parameters.parameter import RESTORE
from applr_ros1.planner.parameters.trees import Tree, Values, branch


class Change(NamedTuple):
    """Another value of one parameter.

    Attributes:
        server: dynamic_reconfigure server below move_base; "" is move_base itself.
        name: Name of the parameter on the server.
        before: Value before the change, in the parameter's declared unit.
        after: Value after the change.
    """

    server: str
    name: str
    before: Any
    after: Any

    def __str__(self) -> str:
        """Return the change in words, such as "inflation_radius 1 -> 0.5"."""
        return f"{self.name} {in_words(self.before)} -> {in_words(self.after)}"

    @property
    def path(self) -> str:
        """Name of the parameter below move_base, such as "DWAPlannerROS/sim_time"."""
        return f"{self.server}/{self.name}".lstrip("/")

    @property
    def departure(self) -> float:
        """Ratio of the larger to the smaller value (ratio_of)."""
        return ratio_of(self.before, self.after)

    def leads_away(self, default: Any) -> bool:
        """Return whether a number becomes less like the C++ default.

        Such a change may help, but what it makes up for is another value.
        """
        values = self.before, self.after, default
        if any(isinstance(value, (bool, str)) for value in values):
            return False
        is_away: bool = abs(self.after - default) > abs(self.before - default)
        return is_away

    @property
    def advice(self) -> str:
        """The change as an instruction, such as "set planner_frequency to 1 instead of 0"."""
        return f"set {self.path} to {in_words(self.after)} instead of {in_words(self.before)}"


def ratio_of(value: Any, other_value: Any) -> float:
    """Return the ratio of the larger to the smaller of two values.

    It is 1 for values without a size, and inf if a sign changes.
    """
    if isinstance(value, (bool, str)) or isinstance(other_value, (bool, str)):
        return 1.0
    if value * other_value <= 0.0:
        return math.inf
    ratio: float = max(value / other_value, other_value / value)
    return ratio


def in_words(value: Any) -> str:
    """Return a value for people; numbers have four significant digits."""
    return f"{value:.4g}" if isinstance(value, (int, float)) else str(value)


class Settings(Mapping[str, Values]):
    """Immutable values of parameters: {server: {name: value}}.

    The values of one server are one request.

    Args:
        values: {server: {name: value}}, which are copied.
    """

    def __init__(self, values: Mapping[str, Values]):
        self._values = {}
        for server, server_values in values.items():
            # The values of other settings never change: these settings share them.
            if not isinstance(server_values, MappingProxyType):
                server_values = MappingProxyType(dict(server_values))
            self._values[server] = server_values

    def __getitem__(self, server: str) -> Values:
        return self._values[server]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __deepcopy__(self, memo: Dict[int, Any]) -> Settings:
        """Return the settings themselves, because they never change."""
        return self

    @classmethod
    def from_tree(cls, tree: Tree) -> Settings:
        """Return the values of all servers in a complete parameter tree (check.complete).

        They are under their latest names.
        """
        values: Dict[str, Tree] = {}
        for server, declaration in servers(tree).items():
            section = branch(tree, server)
            values[server] = {}
            for parameter in declaration.parameters:
                if parameter is not RESTORE:  # It is a command, which has no lasting value.
                    values[server][parameter.name] = section[parameter.name]
        return cls(values)

    def with_(self, *changes: Change) -> Settings:
        """Return the settings after some changes, whatever the values before."""
        values = {server: dict(server_values) for server, server_values in self.items()}
        for change in changes:
            values.setdefault(change.server, {})[change.name] = change.after
        return Settings(values)

    def replaced(self, server: str, values: Values) -> Settings:
        """Return the settings with other values of one server {name: value}."""
        return Settings({**self._values, server: values})

    def only(self, servers: Iterable[str]) -> Settings:
        """Return the settings of some servers."""
        return Settings({server: self._values[server] for server in servers})

    def differences(self, other: Mapping[str, Values]) -> List[Change]:
        """Return the changes from these settings to others.

        Values that the others lack do not differ.
        """
        # Both sides may know servers that the other lacks, such as those of another planner.
        changes = []
        for server, values in self.items():
            other_values = other.get(server, {})
            for name, value in values.items():
                if other_values.get(name, value) != value:
                    changes.append(Change(server, name, value, other_values[name]))
        return changes


def are_in_force(values: Values, configuration: Values) -> bool:
    """Return whether a server's configuration {name: value} already has these values.

    Needless calls are harmful: C++ clears a costmap at every call of its server
    (Costmap2DROS::reconfigureCB).
    """
    return all(configuration.get(name) == value for name, value in values.items())
