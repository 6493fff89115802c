"""Options of the training commands: each is declared once, as a field of a pydantic model, and checked by it.

A field's name, type, bounds, default and help text give the command line (`add_options`), the keys of a YAML or JSON
file of options, and the one-line error about a value that does not fit (`checked`).
"""

from __future__ import annotations

import argparse
from typing import Any, Dict, Mapping, Type, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from applr_ros1.common.errors import ApplrError


def option(default: Any, help: str, fixed: bool = False, **bounds: Any) -> Any:
    """Declare an option, a field of a class derived from Options.

    Args:
        default: its default; a list is copied for each instance.
        help: its help text, whole sentences that stand by themselves.
        fixed: whether a run that is resumed keeps the value that it began with.
        bounds: what pydantic.Field takes: ge, gt, le, lt, min_length, max_length, ...
    """
    return Field(default, description=help, json_schema_extra={"fixed": fixed}, **bounds)


class Options(BaseModel):
    """Base of the classes that declare options; model_config["title"] is the group's heading in the help text.

    A command's options are one class that derives from all of its groups.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


O = TypeVar("O", bound=Options)


def add_options(parser: argparse.ArgumentParser, model: Type[Options]) -> None:
    """Declares an option for each field of the model, in groups; what is not given stays out of the namespace."""
    for group in (cls for cls in model.__mro__ if issubclass(cls, Options)):
        names = [name for name in group.__dict__.get("__annotations__", ()) if name in model.model_fields]
        if names:
            section = parser.add_argument_group(group.model_config.get("title"))
            for name in names:
                _add(section, name, model.model_fields[name])


def _add(section: argparse._ArgumentGroup, name: str, field: FieldInfo) -> None:
    several = get_origin(field.annotation) is list
    shown = " ".join(map(str, field.default)) if several else str(field.default)
    text = (field.description or "") + (f" Default: {shown}." if shown else "")
    more: Dict[str, Any] = {"metavar": name.upper()}
    if field.annotation is bool:
        more = {"action": argparse.BooleanOptionalAction}
    elif several:
        more["nargs"] = "+"
    elif choices := get_args(field.annotation):
        more["metavar"] = "{%s}" % ",".join(map(str, choices))
    section.add_argument(dashed(name), default=argparse.SUPPRESS, help=text.replace("%", "%%"), **more)


def dashed(name: str) -> str:
    """An option as the command line spells it, such as --batch-size."""
    return "--" + name.replace("_", "-")


def checked(model: Type[O], values: Mapping[str, Any], where: str = "") -> O:
    """The options with these values and, for the rest, their defaults.

    Args:
        model: what the options are.
        values: by name; texts are converted, as those of a command line.
        where: the file that they come from; "" for the command line.

    Raises:
        ApplrError: with one line, for an unknown name or a value that does not fit.
    """
    try:
        return model(**values)
    except ValidationError as refused:
        problem = refused.errors()[0]
        text = problem["msg"].removeprefix("Value error, ")
        name = str(problem["loc"][0]) if problem["loc"] else ""
        prefix = f"{where}: " if where else ""
        if problem["type"] == "extra_forbidden":
            raise ApplrError(f"{prefix}unknown option {name!r}") from None
        if name:
            shown = name if where else dashed(name)
            text = f"{shown} is {problem['input']!r:.80}: {text[0].lower()}{text[1:]}"
        raise ApplrError(prefix + text) from None
