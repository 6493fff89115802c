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
            self._start[server] = {name: p.clamp(section[name]) for name, p in parameters.items()}
        self.restore()

    def restore(self) -> None:
        """Restore the start-up values of all servers."""
        self._current = {server: dict(values) for server, values in self._start.items()}

    def __getitem__(self, server: str) -> Dict[str, Any]:
        """Return the values of one server by name, including older names; read-only."""
        try:
            return self._current[server]
        except KeyError:
            known = ", ".join(map(repr, self._start))
            raise ParameterError(f"no server {server!r}: give one of {known}") from None

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
        for p in self._declared[server]:
            names = [name for name in p.names if name in requested]
            changed = [name for name in names if requested[name] != current[p.name]]
            if names:
                deciding = (changed or names)[0]
                requested.update(dict.fromkeys(p.names, requested[deciding]))

        result = {**current, **requested}
        if server in CONTRADICTIONS:
            for line in CONTRADICTIONS[server](result):
                # Only the first conflict is reported.
                raise ParameterError(f"{server}/{line}")
        if server == "":
            # No other planner can be loaded at run time.
            for name in ("base_global_planner", "base_local_planner"):
                result[name] = self._start[server][name]
        return result

    def accept(self, server: str, values: Dict[str, Any]) -> None:
        """Apply the values that request() returned."""
        self._current[server] = values
