"""The section parameter_space of robot.yaml: which values of move_base a policy or a search sets, and how far.

reader.py reads it and calls `space`.
"""

from __future__ import annotations

from typing import Dict, Optional, Tuple

from pydantic import Field, StrictBool, StrictFloat, model_validator
from typing_extensions import Annotated

from applr_ros1.robots.description import Setting, SpaceParameter
from applr_ros1.robots.field_types import PATH, Section

MAX_PARAMETERS = 64
ParameterName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$")]
ValueName = Annotated[str, Field(pattern=f"^{PATH}$")]
Server = Annotated[str, Field(pattern=f"^({PATH})?$")]  # "": move_base itself
Bound = Annotated[StrictFloat, Field(ge=-1e6, le=1e6)]


class SetEntry(Section):
    """One value that is set: of this server below move_base, with the parameter's own name where none is given."""

    server: Server
    name: Optional[ValueName] = None
    aliases: Tuple[ValueName, ...] = ()
    negated: StrictBool = False


class SpaceEntry(Section):
    """One parameter of the space: its range, and the values that are set from it."""

    range: Tuple[Bound, Bound]
    sets: Tuple[SetEntry, ...] = Field(min_length=1)
    integer: StrictBool = False
    paper: StrictBool = True

    @model_validator(mode="after")
    def _agrees(self) -> SpaceEntry:
        low, high = self.range
        if not low < high:
            raise ValueError(f"range is [{low:g}, {high:g}]: give a smaller number and a larger one")
        if self.integer and not (low.is_integer() and high.is_integer()):
            raise ValueError(f"range is [{low:g}, {high:g}]: give whole numbers for an integer")
        if self.sets[0].negated:
            raise ValueError("sets[0] is negated: give the value that has the parameter's own sign first")
        return self


def space(stated: Dict[str, SpaceEntry]) -> Tuple[SpaceParameter, ...]:
    """The parameters in the order of the file."""
    return tuple(
        SpaceParameter(
            name,
            *given.range,
            given.integer,
            tuple(Setting(one.server, (one.name or name, *one.aliases), one.negated) for one in given.sets),
            given.paper,
        )
        for name, given in stated.items()
    )
