"""Methods by name, for the nodes and for evaluation alike: make("applr"), make("period:2:applr")."""

from __future__ import annotations

import os
import re
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import actor
from applr_ros1.policy.decision import Method, period_of
from applr_ros1.policy.methods.included import Exploration, FixedParameters, RandomParameters
from applr_ros1.policy.methods.user_method import make_user_method
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot

NAME = re.compile(r"^[\w.:+-]{1,60}$", re.ASCII)  # of a method in trials.csv
POLICY, SET = "applr.safetensors", "static.json"  # in a robot's folder: its policy, its tuned set
USER_METHOD = re.compile(r"^(.+\.py|[A-Za-z_][\w.]*):([A-Za-z_]\w*)(?::(.*))?$")  # my_file.py:Class:text


def shipped(name: str, robot: Robot) -> str:
    """Return the path of a file in the robot's folder that a method drives with, whether it exists or not."""
    return os.path.join(robot.folder, name)


def auto(robot: Robot) -> str:
    """Name the method that `auto` stands for: the robot's policy, else its tuned set, else its own parameters."""
    files = {"applr": POLICY, "static": SET}
    return next((name for name, file in files.items() if os.path.exists(shipped(file, robot))), "dwa")


def _policy(path: str, robot: Robot) -> Method:
    return actor.load(path, robot, actor.KINDS)


def _fixed(path: str, robot: Robot) -> Method:
    if not path:
        raise ApplrError('method fixed has no set of parameters: give a JSON file such as {"max_vel_x": 1.0}')
    space = space_of(robot)
    values, per_cell = space.read(path)
    return FixedParameters(values, space, per_cell)


def _trained(robot: Robot) -> Method:
    path = shipped(POLICY, robot)
    if not os.path.exists(path):
        raise ApplrError(
            "applr: there is no %s: find a set with `./applr tune %s`, then train a policy that begins there with "
            "`python -m training.train --recipe jackal --robot %s`" % (path, *[robot.folder] * 2)
        )
    return _policy(path, robot)


def _tuned(robot: Robot) -> Method:
    path = shipped(SET, robot)
    if not os.path.exists(path):
        raise ApplrError("static: there is no %s, which `./applr tune %s` writes" % (path, robot.folder))
    return _fixed(path, robot)


def _explored(robot: Robot) -> Method:
    tuned = os.path.exists(shipped(SET, robot))
    around = _tuned(robot) if tuned else _named({}, robot)
    assert isinstance(around, FixedParameters)
    return Exploration(around)


def _named(values: Dict[str, float], robot: Robot) -> Method:
    space = space_of(robot)
    return FixedParameters(space.from_dict(values), space)


METHODS: Dict[str, Tuple[Callable[[Robot], Method], str]] = {
    "dwa": (lambda robot: _named({}, robot), "the planner's default parameters, theta_0"),
    "auto": (
        lambda robot: METHODS[auto(robot)][0](robot),
        "applr where the robot's folder has a policy, else static where it has a set, else dwa",
    ),
    "fast_dwa": (
        lambda robot: _named({"max_vel_x": 1.0, "vx_samples": 12}, robot),
        "theta_0 with max_vel_x 1.0 and 12 vx samples, as in the BARN Challenge",
    ),
    "static": (
        _tuned,
        "the best single set that CMA-ES found on the training worlds",
    ),
    "random": (lambda robot: RandomParameters(space_of(robot)), "uniform over the ranges, every step"),
    "explore": (_explored, "around the robot's tuned set, else its own parameters, drawn anew every second"),
    "applr": (
        _trained,
        "the robot's policy",
    ),
    "appld": (
        lambda robot: _policy(shipped("appld.safetensors", robot), robot),
        "the shipped contexts and classifier",
    ),
}
FILES: Dict[str, Callable[[str, Robot], Method]] = {"applr": _policy, "fixed": _fixed}  # KIND:FILE
FORMS = (
    "%s, a policy (.safetensors), a set (.json), period:SECONDS:METHOD, module:Class or my_file.py:Class, or "
    "NAME=any of these" % ", ".join(METHODS)
)


def make(spec: str, robot: Robot = JACKAL, user_code: bool = True) -> Method:
    """A method by its specification (FORMS) for a robot.

    Args:
        spec: The specification.
        robot: Whose parameters the method sets.
        user_code: Whether a person's own module or file may be imported for it.

    Raises:
        ApplrError: Of one line.
    """
    method = _made(spec, robot, user_code)
    if method.space.robot != robot.name:
        raise ApplrError("method %s is for the robot %s: here %s runs" % (spec, method.space.robot, robot.name))
    method.name = auto(robot) if spec == "auto" else spec
    return method


def for_robot(method: Method, robot: Robot) -> Method:
    """The method itself, with the robot's space and layout where it states none."""
    for name, of in (("space", space_of), ("layout", layout_of)):
        if name not in vars(method) and getattr(type(method), name) is getattr(Method, name):
            setattr(method, name, of(robot))
    return method


class _Specification(NamedTuple):
    """A specification, taken apart.

    period: the text of SECONDS of "period:SECONDS:" before the rest; None without it.
    kind: a name of METHODS or FILES; "" for a person's own class. file: of a policy or of a set.
    user: (module or .py file, class, text for its constructor or None), else None.
    """

    period: Optional[str]
    kind: str
    file: str = ""
    user: Optional[Tuple[str, str, Optional[str]]] = None


def _parsed(spec: str) -> _Specification:
    """The parts of a specification. Raises ApplrError where there is no such form."""
    period, rest = None, spec
    if spec.startswith("period:"):
        period, _, rest = spec[len("period:") :].partition(":")
    kind, colon, file = rest.partition(":")
    match = USER_METHOD.match(rest)
    if rest in METHODS:
        return _Specification(period, rest)
    if kind in FILES and (colon or kind == "fixed"):
        return _Specification(period, kind, file)
    if match:
        return _Specification(period, "", "", (match.group(1), match.group(2), match.group(3)))
    for ending, kind in ((".safetensors", "applr"), (".json", "fixed")):
        if rest.endswith(ending):
            return _Specification(period, kind, rest)
    raise ApplrError("method %r is not known: give %s" % (rest, FORMS))


def _made(spec: str, robot: Robot, user_code: bool) -> Method:
    parts = _parsed(spec)
    if parts.user and not user_code:
        raise ApplrError("method %s is code of one's own: start the node with _method:=%s" % (spec, spec))
    if parts.user:
        method = make_user_method(":".join(filter(None, parts.user)), *parts.user)
    elif parts.file or parts.kind not in METHODS:
        method = FILES[parts.kind](parts.file, robot)
    else:
        method = METHODS[parts.kind][0](robot)
    if parts.period is not None:
        try:
            method.period = period_of({"period_s": float(parts.period)})
        except ValueError:
            raise ApplrError("period:%s: give a decision period from 0.05 to 60 s" % parts.period) from None
    return for_robot(method, robot)


def absolute(spec: str) -> str:
    """The same specification for another folder: files, and modules that lie in the current folder, as paths.

    The text for the constructor of a person's own class becomes a path where it is that of a file here.
    """
    parts = _parsed(spec)
    words = [] if parts.period is None else ["period", parts.period]
    if parts.user:
        module, name, text = parts.user
        file = module if module.endswith(".py") else module + ".py"
        words += [os.path.abspath(file) if module.endswith(".py") or os.path.isfile(file) else module, name]
        words += [] if text is None else [os.path.abspath(text) if os.path.isfile(text) else text]
    else:
        words += [parts.kind, *([os.path.abspath(parts.file)] if parts.file else [])]
    return ":".join(words)


def parse(text: str, robot: Robot = JACKAL) -> List[Tuple[str, str]]:
    """[(name, specification), ...] of a comma-separated list. Names are what trials.csv shows. Raises ApplrError."""
    found: List[Tuple[str, str]] = []
    for item in (part.strip() for part in text.split(",")):
        name, given, spec = item.partition("=")
        spec = spec if given else item
        found.append((name if given else _name(spec), spec))
    for name, spec in found:
        if not NAME.match(name):
            raise ApplrError("method %r cannot be called %r: use letters, digits and ._:+-" % (spec[:80], name[:80]))
        if [n for n, _ in found].count(name) > 1:
            raise ApplrError("two methods are called %r: give them names, NAME=%s" % (name, spec))
    return found


def _name(spec: str) -> str:
    """Return the name of a method to which the person gave none."""
    parts = _parsed(spec)
    name = parts.user[1] if parts.user else os.path.splitext(os.path.basename(parts.file))[0] or parts.kind
    return name if parts.period is None else "%s-%ss" % (name, parts.period)
