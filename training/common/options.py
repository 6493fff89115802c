"""Options of the training commands: each is declared once, as a field of a pydantic model, and checked by it.

A field's name, type, bounds, default and help text give the command line (`add_options`), the keys of a YAML or JSON
file of options, and the one-line error about a value that does not fit (`checked`).
"""

from __future__ import annotations

import argparse
from typing import Any, Dict, List, Literal, Mapping, Type, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from applr_ros1.common.errors import ApplrError

PLACE: Dict[str, Any] = {"place": True}


def option(default: Any, help: str, fixed: bool = False, **bounds: Any) -> Any:
    """Declare an option, a field of a class derived from Options.

    Args:
        default: its default; a list is copied for each instance. None or "": none that the help text shall name; ...:
            none, the option must be given.
        help: its help text, whole sentences that stand by themselves; "" hides the option.
        fixed: whether a run that is resumed keeps the value that it began with.
        bounds: what pydantic.Field takes: ge, gt, le, lt, min_length, max_length, ...
    """
    return Field(default, description=help, json_schema_extra={"fixed": fixed}, **bounds)


def argument(help: str, **bounds: Any) -> Any:
    """Declare what is given by its place, without a name before it; arguments as for option."""
    return Field(description=help, json_schema_extra=PLACE, **bounds)


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
            title = group.model_config.get("title")
            section = parser.add_argument_group(title) if title else parser
            for name in names:
                _add(section, name, model.model_fields[name])


def _add(section: argparse._ActionsContainer, name: str, field: FieldInfo) -> None:
    several, default = get_origin(field.annotation) is list, None if field.is_required() else field.default
    if field.json_schema_extra == PLACE:
        section.add_argument(name, nargs="+" if several else None, help=field.description)
        return
    shown = "" if default is None else " ".join(map(str, default)) if several else str(default)
    text = (field.description or "") + (f" Default: {shown}." if shown else "")
    more: Dict[str, Any] = {"metavar": name.upper(), "required": field.is_required()}
    if field.annotation is bool:
        more = {"action": argparse.BooleanOptionalAction}
    elif field.annotation == List[str]:
        more["action"] = "append"
    elif several:
        more["nargs"] = "+"
    elif get_origin(field.annotation) is Literal:
        more["metavar"] = f"{{{','.join(filter(None, get_args(field.annotation)))}}}"
    shown_help = text.replace("%", "%%") if field.description else argparse.SUPPRESS
    section.add_argument(dashed(name), dest=name, default=argparse.SUPPRESS, help=shown_help, **more)


def dashed(name: str) -> str:
    """An option as the command line spells it, such as --batch-size; for_ is --for."""
    return "--" + name.rstrip("_").replace("_", "-")


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
        ours = problem.get("ctx", {}).get("error")  # what a validator of this package raised
        text = str(ours or problem["msg"][0].lower() + problem["msg"][1:])
        name = str(problem["loc"][0]) if problem["loc"] else ""
        prefix = f"{where}: " if where else ""
        if problem["type"] == "extra_forbidden":
            raise ApplrError(f"{prefix}unknown option {name!r}") from None
        if name:
            place = name in model.model_fields and model.model_fields[name].json_schema_extra == PLACE
            shown = name if where or place else dashed(name)
            text = f"{shown} is {problem['input']!r:.80}: {text}"
        raise ApplrError(prefix + text) from None
