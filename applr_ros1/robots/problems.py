"""What is wrong with a robot's description: RobotError, with a line in the project's words for each mistake."""

from __future__ import annotations

from typing import Any, Dict, Iterable, Tuple, get_args

from pydantic import ValidationError

from applr_ros1.common.errors import ApplrError, meant

_MAPPING = "give a mapping of names and values"
_GIVE = {  # by pydantic's kind of mistake; otherwise its own words count
    "string_pattern_mismatch": "give a name such as front/scan",
    "tuple_type": "give a list",
    "dict_type": _MAPPING,
    "model_type": _MAPPING,
    "greater_than_equal": "give at least {ge:g} {unit}",
    "less_than_equal": "give at most {le:g} {unit}",
    "too_short": "give at least {min_length} of them",
    "too_long": "give at most {max_length} of them",
}


class RobotError(ApplrError):
    """One or more mistakes in a robot's description.

    lines: one for each, with file, key, value, and what to give. The error's own text is the first of them.
    """

    def __init__(self, lines: Iterable[str]):
        self.lines: Tuple[str, ...] = tuple(lines)
        super().__init__(self.lines)

    def __str__(self) -> str:
        more = len(self.lines) - 1
        return self.lines[0] + (f" ({more} more: check_robot.py lists them)" if more else "")


def refuse(lines: Iterable[str]) -> None:
    """Raise RobotError where there is a line."""
    found = tuple(lines)
    if found:
        raise RobotError(found)


def lines_of(model: Any, error: ValidationError) -> Iterable[str]:
    """What pydantic refused in the values of a model: a line for each mistake, unknown names first."""
    found = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    return dict.fromkeys(_line(model, problem) for problem in found)


def _line(model: Any, problem: Any) -> str:
    kind, parts = problem["type"], [part for part in problem["loc"] if part != "[key]"]
    few = kind == "missing" and isinstance(parts[-1], int)  # numbers in a list
    label = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts[: -1 if few else None])[1:]
    if kind == "value_error":  # one of ours, which begins with the field's name
        return f"{label}.{problem['ctx']['error']}"
    known, unit = _declared(model, parts)
    if kind == "extra_forbidden":
        return f"{label} is unknown: {meant(parts[-1], known, 'there are ' + ', '.join(known))}"
    if kind == "missing" and not few:
        return f"{label} is missing: give it"
    give = "give more numbers" if few else _GIVE.get(kind, problem["msg"].replace("Input should be", "give"))
    return f"{label} is {problem['input']!r:.60}: {give.format(**problem.get('ctx', {}), unit=unit)}".rstrip()


def _declared(kind: Any, parts: Iterable[Any]) -> Tuple[Dict[str, Any], str]:
    """The names that the last section on the way to a value knows, and the value's unit ("" for none)."""
    known: Dict[str, Any] = {}
    unit = ""
    for part in parts:
        while not hasattr(kind, "model_fields") and get_args(kind):  # Optional, Dict or Tuple of sections
            kind = next((one for one in reversed(get_args(kind)) if one not in (type(None), ...)), None)
        known = getattr(kind, "model_fields", known)
        if part in known:
            kind, unit = known[part].annotation, (known[part].json_schema_extra or {}).get("unit", "")
    return known, unit
