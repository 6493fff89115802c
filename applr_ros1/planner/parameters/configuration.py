"""Current values of the dynamic_reconfigure servers, changed by requests that are accepted or rejected as a whole.

MoveBase has one configuration, which knows the declarations but not the effect of the values.
"""

from __future__ import annotations

from typing import Any, Dict

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.declarations import CONTRADICTIONS, servers
from applr_ros1.planner.parameters.parameter import ParameterError


class Configuration:
    """Current and start-up values of all servers, from a complete parameter tree (check.complete)."""

    def __init__(self, tree: Dict[str, Any]):
        self._start: Dict[str, Dict[str, Any]] = {}
        self._declared = {name: server.parameters for name, server in servers(tree).items()}
        self._tables = {
            name: {key: p for p in declared for key in p.names}
            for name, declared in self._declared.items()
        }
        for server, table in self._tables.items():
            here = branch(tree, server)
            self._start[server] = {name: p.clamp(here[name]) for name, p in table.items()}
        self.restore()

    def restore(self) -> None:
        """Restore the start-up values of all servers."""
        self._now = {server: dict(values) for server, values in self._start.items()}

    def __getitem__(self, server: str) -> Dict[str, Any]:
        """Return the values of one server by name, including older names; read-only."""
        try:
            return self._now[server]
        except KeyError:
            known = ", ".join(map(repr, self._start))
            raise ParameterError(f"no server {server!r}: give one of {known}") from None

    def start_up(self, server: str) -> Dict[str, Any]:
        """Return a copy of the start-up values of one server."""
        return dict(self._start[server])

    def request(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """Return the server's values after a request: converted, clamped, with older names updated.

        Changes nothing yet (see accept). If a parameter is given under both names, the value that differs from the
        current one is used. If both differ, the newer name wins.

        Raises:
            ParameterError: A name is unknown, or a value is not finite, has another type or cannot be used.
        """
        table, has = self._tables.get(server, {}), self[server]
        wanted = {}
        for name, value in values.items():
            if name not in table:
                raise ParameterError(f"{name}: no such parameter of server {server!r}")
            wanted[name] = table[name].taken(value)
        if wanted.get("restore_defaults"):
            return dict(self._start[server])
        for p in self._declared[server]:
            if p.aliases:
                names = [name for name in p.names if name in wanted]
                changed = [name for name in names if wanted[name] != has[p.name]]
                if names:
                    wanted.update(dict.fromkeys(p.names, wanted[(changed or names)[0]]))
        new = {**has, **wanted}
        for line in CONTRADICTIONS[server](new) if server in CONTRADICTIONS else ():
            raise ParameterError(f"{server}/{line}")  # Only the first conflict is reported.
        if server == "":
            for name in ("base_global_planner", "base_local_planner"):
                new[name] = self._start[server][name]  # No other planner can be loaded at run time.
        return new

    def accept(self, server: str, new: Dict[str, Any]) -> None:
        """Apply the values that request() returned."""
        self._now[server] = new
