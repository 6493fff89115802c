"""The values in force in the dynamic_reconfigure servers: takes requests whole or refuses them whole.

MoveBase keeps one of these; it knows the declarations but not what the values do.
"""

from __future__ import annotations

from typing import Any, Dict

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.declarations import CONTRADICTIONS, servers
from applr_ros1.planner.parameters.parameter import ParameterError


class Configuration:
    """`tree`: a complete parameter tree (check.complete); its values are those to return to."""

    def __init__(self, tree: Dict[str, Any]):
        self._start: Dict[str, Dict[str, Any]] = {}
        self._declared = {name: server.parameters for name, server in servers(tree).items()}
        self._tables = {
            name: {key: p for p in declared for key in p.names} for name, declared in self._declared.items()
        }
        for server, table in self._tables.items():
            here = branch(tree, server)
            self._start[server] = {name: p.clamp(here[name]) for name, p in table.items()}
        self.restore()

    def restore(self) -> None:
        """Everything back to its start-up value."""
        self._now = {server: dict(values) for server, values in self._start.items()}

    def __getitem__(self, server: str) -> Dict[str, Any]:
        """The values of one server by name, older names included; not to be changed."""
        try:
            return self._now[server]
        except KeyError:
            known = ", ".join(map(repr, self._start))
            raise ParameterError(f"no server {server!r}: give one of {known}") from None

    def start_up(self, server: str) -> Dict[str, Any]:
        """The values of one server when it started."""
        return dict(self._start[server])

    def request(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """What the server would have after taking `values`: converted, clamped, older names following.

        Nothing changes yet (see accept). ParameterError, one line, for an unknown name or a value that is not
        finite, of another type, or useless: then the whole request counts for nothing. A parameter given
        under both names takes the one that differs from the present value, the newer name first.
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
            raise ParameterError(f"{server}/{line}")  # the first
        if server == "":
            for name in ("base_global_planner", "base_local_planner"):
                new[name] = self._start[server][name]  # nothing else can be loaded: it stays
        return new

    def accept(self, server: str, new: Dict[str, Any]) -> None:
        """Put a dict made by request() in force."""
        self._now[server] = new
