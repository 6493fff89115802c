"""What is wrong with a robot.yaml by itself: what its schema refuses, and fields that contradict each other.

reader.py calls `of_schema` and `contradictions`; check.py has the rules about the parameter files, in the same form.
"""

from __future__ import annotations

import re
from math import pi
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Tuple, get_args

import numpy as np
from pydantic import ValidationError

from applr_ros1.common.errors import ApplrError, Finding, meant
from applr_ros1.robots import geometry
from applr_ros1.robots.description import Robot

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


INSIDE = 0.3  # share of the body's width; lasers in a slit are nearer to its side


class RobotError(ApplrError):
    """One or more mistakes in a robot's description: `findings`. The error's own text is the first of them."""

    def __init__(self, findings: Iterable[Finding]):
        self.findings: Tuple[Finding, ...] = tuple(findings)
        super().__init__(self.findings)

    def __str__(self) -> str:
        more = len(self.findings) - 1
        return str(self.findings[0]) + (f" ({more} more: check_robot.py lists them)" if more else "")


def refuse(findings: Iterable[Finding], file: str = "") -> None:
    """Raise RobotError where there is an error among the findings, which are about `file` where they name none."""
    found = [finding._replace(file=finding.file or file) for finding in findings if finding.severity == "error"]
    if found:
        raise RobotError(found)


def in_one_line(findings: List[Finding]) -> Finding:
    """Findings about one file as one, which says once what they say of several keys."""
    alike: Dict[Tuple[str, str], List[str]] = {}
    for finding in findings:
        alike.setdefault((finding.value, finding.advice), []).append(finding.key)
    texts = []
    for (value, advice), keys in alike.items():
        value = re.sub("^is ", "are ", re.sub("^has ", "have ", value)) if keys[1:] else value
        texts.append(str(Finding(", ".join(keys), value, advice)))
    return findings[0]._replace(key="; ".join(texts), value="", advice="")


def of_schema(model: Any, error: ValidationError) -> List[Finding]:
    """What pydantic refused in the values of a model, unknown names first."""
    found = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    return list(dict.fromkeys(_finding(model, problem) for problem in found))


def _finding(model: Any, problem: Any) -> Finding:
    kind, parts = problem["type"], [part for part in problem["loc"] if part != "[key]"]
    few = kind == "missing" and isinstance(parts[-1], int)  # numbers in a list
    label = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts[: -1 if few else None])[1:]
    if kind == "value_error":  # one of ours: "NAME is VALUE: ADVICE"
        key, _, rest = str(problem["ctx"]["error"]).partition(" ")
        value, _, advice = rest.partition(": ")
        return Finding(f"{label}.{key}", value, advice)
    known, unit = _declared(model, parts)
    if kind == "extra_forbidden":
        return Finding(label, "is unknown", meant(parts[-1], known, "there are " + ", ".join(known)))
    if kind == "missing" and not few:
        return Finding(label, "is missing", "give it")
    give = "give more numbers" if few else _GIVE.get(kind, problem["msg"].replace("Input should be", "give"))
    return Finding(label, f"is {problem['input']!r:.60}", give.format(**problem.get("ctx", {}), unit=unit).rstrip())


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


class Rule(NamedTuple):
    """One thing to look at.

    key: the field. wrong: whether there is something to say, of values v and measures m. advice: why it is wrong and
    what to give, a format string of v and m.
    """

    key: str
    wrong: Callable[[Any, Any], Any]
    advice: str
    severity: Any = "error"


def always(v: Any, m: Any) -> bool:
    """The condition of a rule that has none."""
    return True


def at_most(key: str, limit: str, when: Callable[[Any, Any], Any] = always, severity: str = "error") -> Rule:
    """The rule that one of the values is not larger than another."""
    low, high = attrgetter(key), attrgetter(limit)
    advice = f"{limit} is {{v.{limit}:g}}, give at most that"
    return Rule(key, lambda v, m: when(v, m) and low(v) > high(v), advice, severity)


def same_name(key: str, field: str, when: Callable[[Any, Any], Any] = always, severity: str = "error") -> Rule:
    """The rule that a value is the topic or frame that a field of robot.yaml names."""
    given, wanted = attrgetter(key), attrgetter(field)
    advice = f"{field} in robot.yaml is {{m.{field}}}, give that" + " or leave it out" * (severity == "remark")
    return Rule(
        key, lambda v, m: when(v, m) and wanted(m) and given(v).strip("/") != wanted(m).strip("/"), advice, severity
    )


def apply(rules: Iterable[Rule], v: Any, m: Any) -> Iterator[Finding]:
    """What rules say of values v, whose attributes their keys are, and measures m."""
    for rule in rules:
        if rule.wrong(v, m):
            yield Finding(rule.key, stated(attrgetter(rule.key)(v)), rule.advice.format(v=v, m=m), rule.severity)


def stated(value: Any) -> str:
    """How a finding names a value."""
    if value is None or value == ():
        return "is missing"
    if isinstance(value, tuple):
        return f"is [{', '.join(f'{number:g}' for number in value)}]"
    if isinstance(value, bool):
        return f"is {str(value).lower()}"
    return f"is {value:g}" if isinstance(value, float) else f"is {value!s:.60}"


RULES = (
    Rule(
        "base.wheelbase",
        lambda v, m: m.skids and not v.base.wheelbase,
        "a skid_steer base has two axles, give their distance",
    ),
    Rule(
        "base.wheelbase", lambda v, m: not m.skids and v.base.wheelbase, "a two_wheel base has one axle, leave it out"
    ),
    Rule("base.casters", lambda v, m: m.skids and v.base.casters, "a skid_steer base has none, leave them out"),
    Rule(
        "base.casters",
        lambda v, m: not m.skids and not v.base.casters,
        "a two_wheel base stands on one at least, give where they touch the ground",
    ),
    Rule(
        "simulation.ground",
        lambda v, m: v.simulation.ground == "gazebo" and not m.skids,
        "it is for a skid_steer base, give plain",
    ),
    Rule(
        "simulation.track_multiplier",
        lambda v, m: v.simulation.ground == "gazebo" and v.simulation.track_multiplier is None,
        "ground gazebo needs the one of the wheels' controller",
    ),
    Rule("laser.last_angle", lambda v, m: m.turn <= 0.0, "give more than first_angle {v.laser.first_angle:g}"),
    Rule("laser.last_angle", lambda v, m: m.turn > 2 * pi + 1e-3, "from first_angle that is more than a full turn"),
    Rule("laser.range_max", lambda v, m: v.laser.range_max <= m.blind, "give more than range_min {m.blind:g}"),
    Rule(
        "laser.no_return",
        lambda v, m: v.laser.no_return is not None and m.blind <= v.laser.no_return < v.laser.range_max,
        "between range_min and range_max it would hide obstacles",
    ),
    at_most("monitor.deceleration", "base.max_acceleration"),
    at_most("monitor.yaw_deceleration", "base.max_yaw_acceleration"),
    Rule(
        "base.axle_height",
        lambda v, m: v.body.bottom < m.ground,
        "the ground is then at {m.ground:.3g} m, above the body's underside body.bottom {v.body.bottom:g}; give the "
        "axles' height above the base frame",
    ),
    Rule(
        "laser.height",
        lambda v, m: v.laser.height < m.ground <= v.body.bottom,
        "that is below the ground at {m.ground:.3g} m, give metres",
    ),
    Rule(
        "laser.height",
        lambda v, m: v.body.bottom < v.laser.height < v.body.top and m.laser_depth > INSIDE * v.body.size[1],
        "the laser is then deep inside the body, up to {v.body.top:.3g} m; compare laser.pose, laser.height and body",
        "remark",
    ),
    Rule(
        "laser.pose",
        lambda v, m: m.laser_off > max(m.front - m.back, m.left - m.right),
        "body and wheels end at {m.front:.3g} m ahead and {m.left:.3g} m to the left, give metres",
    ),
    Rule(
        "body.com",
        lambda v, m: m.tips,
        "the centre of mass of body and wheels lies outside the wheels and casters; check base.casters, too",
    ),
)


def contradictions(robot: Robot) -> List[Finding]:
    """What the fields of robot.yaml say against each other."""
    base, body, laser = robot.base, robot.body, robot.laser
    (x, y, _), skids = laser.pose, base.drive == "skid_steer" or not base.drive and base.wheelbase
    m = SimpleNamespace(skids=skids, turn=laser.last_angle - laser.first_angle, blind=laser.range_min)
    m.ground = base.axle_height - base.wheel_radius
    m.back, m.front, m.right, m.left = geometry.bounding_box(robot)
    m.laser_off = max(m.back - x, x - m.front, m.right - y, y - m.left)
    m.laser_depth = min(size / 2 - abs(at - middle) for at, middle, size in zip((x, y), body.centre, body.size))
    stands = (base.wheelbase if skids else base.casters) and np.isfinite(geometry.supports(base)).all()
    mass, _, loads = geometry.balance(robot) if stands else (0.0, (), np.zeros(1))
    m.tips = loads.min() < -1e-4 * mass * geometry.GRAVITY  # right above the axle it stands
    return list(apply(RULES, robot, m))
