"""Options of the training commands.

Each is declared once, as a field of a pydantic model. A field's name, type, bounds, default and
help text give the command line, the keys of a YAML or JSON file of options, and the one-line error
about an invalid value.
"""

from __future__ import annotations

import argparse
from typing import Any, Dict, Literal, Mapping, Set, Type, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from applr_ros1.common.errors import ApplrError, remedy_of, shown

PLACE: Dict[str, Any] = {"place": True}  # marks a positional argument in a field's JSON schema


def option(default: Any, help: str, **bounds: Any) -> Any:
    """Declare an option, a field of a class derived from Options.

    Args:
        default: Default value; None and "" are not shown in the help text, and ... makes the option
            required.
        help: Help text, in complete sentences.
        bounds: Arguments of pydantic.Field: ge, gt, le, lt, min_length, max_length, ...
    """
    return Field(default, description=help, **bounds)


def argument(help: str) -> Any:
    """Declare a positional argument."""
    return Field(description=help, json_schema_extra=PLACE)


class Options(BaseModel):
    """Base class of a group of options.

    model_config["title"] is the group's heading in the help text. The options of a command are a
    class that derives from all of its groups.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )


O = TypeVar("O", bound=Options)


def add_options(parser: argparse.ArgumentParser, model: Type[Options]) -> None:
    """Add an option for each field of the model, in groups.

    Options that are not given stay out of the namespace, so that a recipe or a resumed run keeps
    its own values.
    """
    added_names: Set[str] = set()
    for option_group in model.__mro__:
        if not issubclass(option_group, Options):
            continue
        # An option that a derived class overrides is listed there alone.
        declared_names = option_group.__dict__.get("__annotations__", ())
        names = [option_name for option_name in declared_names if option_name not in added_names]
        group_title = option_group.model_config.get("title")
        section: argparse._ActionsContainer = parser
        if group_title and names:
            section = parser.add_argument_group(group_title)
        for option_name in names:
            _add(section, option_name, model.model_fields[option_name])
        added_names.update(names)


def _add(section: argparse._ActionsContainer, name: str, field: FieldInfo) -> None:
    """Add the argument of a field to a section of the help text."""
    type_origin = get_origin(field.annotation)
    nargs = "+" if type_origin is list else None
    if field.json_schema_extra == PLACE:
        section.add_argument(name, nargs=nargs, help=field.description)
        return
    settings: Dict[str, Any] = {"metavar": name.upper(), "nargs": nargs}
    if field.annotation is bool:
        settings = {"action": argparse.BooleanOptionalAction}
    elif type_origin is Literal:
        settings = {"choices": get_args(field.annotation)}
    help_text = str(field.description)
    default = field.default
    if isinstance(default, list):
        default = " ".join(map(str, default))
    if not field.is_required() and default not in (None, ""):
        help_text += f" Default: {default}."
    section.add_argument(
        dashed(name),
        dest=name,
        help=help_text.replace("%", "%%"),  # argparse formats help texts.
        default=argparse.SUPPRESS,
        required=field.is_required(),
        **settings,
    )


def dashed(name: str) -> str:
    """Return an option as the command line spells it, such as --batch-size; for_ is --for."""
    return "--" + name.rstrip("_").replace("_", "-")


def checked(model: Type[O], values: Mapping[str, Any], where: str = "") -> O:
    """Return the options with these values and, for the rest, their defaults.

    Args:
        model: Class of the options.
        values: Values by name; strings are converted to the type of the field.
        where: File that the values come from, or "" for the command line.

    Raises:
        ApplrError: A name is unknown or a value is invalid; the message is one line.
    """
    try:
        return model.model_validate(values)
    except ValidationError as refused:
        refusal = _refusal(model, refused.errors()[0], where)
    raise ApplrError(f"{where}: {refusal}" if where else refusal)


def _refusal(model: Type[O], problem: Mapping[str, Any], where: str) -> str:
    """Return an entry of ValidationError.errors() about options, in words."""
    # A rule about several options names them in its message.
    if not problem["loc"]:
        return remedy_of(problem)
    option_name = str(problem["loc"][0])
    if problem["type"] == "extra_forbidden":
        return f"unknown option {shown(option_name)}"
    if not where and model.model_fields[option_name].json_schema_extra != PLACE:
        option_name = dashed(option_name)
    return f"{option_name} is {shown(problem['input'])}: {remedy_of(problem)}"
