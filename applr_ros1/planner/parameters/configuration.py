"""Settings of the dynamic_reconfigure servers at start-up and now.

Requests change them, which are accepted or rejected as a whole.
MoveBase has one configuration, which knows the declarations but not the effect of the values.
"""

from __future__ import annotations

from typing import Dict

from applr_ros1.planner.parameters.declarations import CONTRADICTIONS, servers
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError, by_name
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.planner.parameters.trees import Tree, Values, branch


class Configuration:
    """Current and start-up settings of all servers.

    Args:
        tree: complete parameter tree (check.complete).

    Attributes:
        servers: declarations of all servers by name.
        start_up: settings of the tree, including older names.
        current: settings in force, under the same names.
    """

    def __init__(self, tree: Tree):
        self.servers = servers(tree)
        self._declared: Dict[str, Dict[str, Parameter]] = {}
        start_values: Dict[str, Tree] = {}
        for server, declaration in self.servers.items():
            section = branch(tree, server)
            self._declared[server] = by_name(declaration.parameters)
            start_values[server] = {name: section[name] for name in self._declared[server]}
        self.start_up = Settings(start_values)
        self.restore_start_up()

    def restore_start_up(self) -> None:
        """Restore the start-up values of all servers."""
        self.current = self.start_up

    def __getitem__(self, server: str) -> Values:
        """Return the current values of one server by name, including older names."""
        try:
            return self.current[server]
        except KeyError:
            known_servers = ", ".join(map(repr, self.start_up))
            raise ParameterError(f"no server {server!r}: give one of {known_servers}") from None

    def result_of(self, server: str, values: Values) -> Values:
        """Return the server's values after a request: converted, clamped, with older names updated.

        Changes nothing yet (see accept). If a parameter is given under both names, the value that
        differs from the current one is used. If both differ, the newer name wins.

        Raises:
            ParameterError: A name is unknown, or a value is not finite, has another type or cannot
            be used.
        """
        # All values are read before any is used: a request is accepted as a whole or not at all.
        declared = self._declared.get(server, {})
        current = self[server]
        requested = {}
        for name, value in values.items():
            if name not in declared:
                raise ParameterError(f"{name}: no such parameter of server {server!r}")
            requested[name] = declared[name].taken(value)
        if requested.get("restore_defaults"):
            return self.start_up[server]

        # Clients such as rqt_reconfigure send all values, so that an older name comes with each
        # newer one.
        for parameter in self.servers[server].parameters:
            given_names = [name for name in parameter.names if name in requested]
            if not given_names:
                continue
            # The newest name comes first, so that it decides if several values have changed.
            deciding_name = given_names[0]
            for name in given_names:
                if requested[name] != current[parameter.name]:
                    deciding_name = name
                    break
            requested.update(dict.fromkeys(parameter.names, requested[deciding_name]))

        result = {**current, **requested}
        if server in CONTRADICTIONS:
            for conflict in CONTRADICTIONS[server](result):
                # Only the first conflict is reported.
                raise ParameterError(f"{server}/{conflict}")
        if server == "":
            # No other planner can be loaded at run time.
            for name in ("base_global_planner", "base_local_planner"):
                result[name] = self.start_up[server][name]
        return result

    def accept(self, server: str, values: Values) -> None:
        """Apply the values that result_of() returned."""
        self.current = self.current.replaced(server, values)
