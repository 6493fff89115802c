"""Current values of the dynamic_reconfigure servers.

Requests change them, which are accepted or rejected as a whole.
MoveBase has one configuration, which knows the declarations but not the effect of the values.
"""

from __future__ import annotations

from typing import Any, Dict, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.declarations import CONTRADICTIONS, servers
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError, by_name


class Configuration:
    """Current and start-up values of all servers.

    Args:
        tree: complete parameter tree (check.complete).
    """

    def __init__(self, tree: Dict[str, Any]):
        self._start: Dict[str, Dict[str, Any]] = {}
        self._declared: Dict[str, Tuple[Parameter, ...]] = {}
        self._by_name: Dict[str, Dict[str, Parameter]] = {}
        for server, declaration in servers(tree).items():
            section = branch(tree, server)
            parameters = by_name(declaration.parameters)
            self._declared[server] = declaration.parameters
            self._by_name[server] = parameters
            self._start[server] = {}
            for name, parameter in parameters.items():
                self._start[server][name] = parameter.clamp(section[name])
        self.restore()

    def restore(self) -> None:
        """Restore the start-up values of all servers."""
        self._current = {server: dict(values) for server, values in self._start.items()}

    def __getitem__(self, server: str) -> Dict[str, Any]:
        """Return the values of one server by name, including older names; read-only."""
        try:
            return self._current[server]
        except KeyError:
            known_servers = ", ".join(map(repr, self._start))
            raise ParameterError(f"no server {server!r}: give one of {known_servers}") from None

    def start_up(self, server: str) -> Dict[str, Any]:
        """Return a copy of the start-up values of one server."""
        return dict(self._start[server])

    def request(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """Return the server's values after a request: converted, clamped, with older names updated.

        Changes nothing yet (see accept). If a parameter is given under both names, the value that
        differs from the current one is used. If both differ, the newer name wins.

        Raises:
            ParameterError: A name is unknown, or a value is not finite, has another type or cannot
            be used.
        """
        # All values are read before any is used: a request is accepted as a whole or not at all.
        parameters = self._by_name.get(server, {})
        current = self[server]
        requested = {}
        for name, value in values.items():
            if name not in parameters:
                raise ParameterError(f"{name}: no such parameter of server {server!r}")
            requested[name] = parameters[name].taken(value)
        if requested.get("restore_defaults"):
            return dict(self._start[server])

        # Clients such as rqt_reconfigure send all values, so that an older name comes with each
        # newer one.
        for parameter in self._declared[server]:
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
                result[name] = self._start[server][name]
        return result

    def accept(self, server: str, values: Dict[str, Any]) -> None:
        """Apply the values that request() returned."""
        self._current[server] = values
