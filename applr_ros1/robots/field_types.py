"""What a value in robot.yaml may be: its sections, which are pydantic models, declare their fields with these types."""

from __future__ import annotations

from typing import Any, Tuple

from pydantic import BaseModel, ConfigDict, Field, StrictFloat
from typing_extensions import Annotated

PATH = "[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*"
Name = Annotated[str, Field(pattern=f"^/?{PATH}$")]  # of a topic or frame
Length = Annotated[StrictFloat, Field(ge=0.01, le=10.0)]
Place = Annotated[StrictFloat, Field(ge=-10.0, le=10.0)]
Inertia = Annotated[StrictFloat, Field(ge=1e-9, le=1e5)]
Length3 = Tuple[Length, Length, Length]
Place2 = Tuple[Place, Place]
Place3 = Tuple[Place, Place, Place]
Inertia3 = Tuple[Inertia, Inertia, Inertia]


class Section(BaseModel):
    """A mapping in robot.yaml: its names are the fields of the derived class."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def real(unit: str, low: float, high: float, default: Any = ...) -> Any:
    """A field that holds a finite number from low to high, in this unit ("" for none)."""
    return Field(default, ge=low, le=high, strict=True, json_schema_extra={"unit": unit})


def whole(low: int, high: int) -> Any:
    """A field that holds a whole number from low to high."""
    return Field(ge=low, le=high, strict=True)


def values(unit: str, default: Any = ..., **bounds: Any) -> Any:
    """A field that holds a list in this unit; bounds as pydantic.Field takes them."""
    return Field(default, json_schema_extra={"unit": unit}, **bounds)
