"""Methods by name, for the nodes and for evaluation alike: make("applr"), make("FILE.safetensors")."""

from __future__ import annotations

import os
import re
from typing import Callable, Dict, List, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import actor
from applr_ros1.policy.decision import Method
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


def _fixed(path: str, robot: Robot) -> FixedParameters:
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


def _tuned(robot: Robot) -> FixedParameters:
    path = shipped(SET, robot)
    if not os.path.exists(path):
        raise ApplrError("static: there is no %s, which `./applr tune %s` writes" % (path, robot.folder))
    return _fixed(path, robot)


def _explored(robot: Robot) -> Method:
    tuned = os.path.exists(shipped(SET, robot))
    return Exploration(_tuned(robot) if tuned else _default(robot))


def _default(robot: Robot) -> FixedParameters:
    space = space_of(robot)
    return FixedParameters(space.from_dict({}), space)


METHODS: Dict[str, Tuple[Callable[[Robot], Method], str]] = {
    "dwa": (_default, "the planner's default parameters, theta_0"),
    "auto": (
        lambda robot: METHODS[auto(robot)][0](robot),
        "applr where the robot's folder has a policy, else static where it has a set, else dwa",
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
FILES: Dict[str, Callable[[str, Robot], Method]] = {".safetensors": _policy, ".json": _fixed}  # by their endings
FORMS = "%s, a policy (.safetensors), a set (.json), or module:Class or my_file.py:Class" % ", ".join(METHODS)


def make(spec: str, robot: Robot = JACKAL, user_code: bool = True) -> Method:
    """Return the method that a specification (FORMS) names, for a robot.

    Args:
        spec: The specification.
        robot: Whose parameters the method sets.
        user_code: Whether a person's own module or file may be imported for it.

    Raises:
        ApplrError: Of one line.
    """
    user = USER_METHOD.match(spec)
    if spec in METHODS:
        method = METHODS[spec][0](robot)
    elif user and not user_code:
        raise ApplrError("method %s is code of one's own: start the node with _method:=%s" % (spec, spec))
    elif user:
        method = make_user_method(*user.groups())
    else:
        method = _reader(spec)(spec, robot)
    method = for_robot(method, robot)
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


def _reader(spec: str) -> Callable[[str, Robot], Method]:
    ending = os.path.splitext(spec)[1]
    if ending not in FILES:
        raise ApplrError("method %r is not known: give %s" % (spec, FORMS))
    return FILES[ending]


def absolute(spec: str) -> str:
    """Return the same specification for another folder: files, and modules of the current folder, as paths.

    The text for the constructor of a person's own class becomes a path if a file of that name is here.
    """
    if spec in METHODS:
        return spec
    user = USER_METHOD.match(spec)
    if not user:
        _reader(spec)  # refuses what is no file of a method
        return os.path.abspath(spec)
    module, name, text = user.groups()
    file = module if module.endswith(".py") else module + ".py"
    words = [os.path.abspath(file) if module.endswith(".py") or os.path.isfile(file) else module, name]
    words += [] if text is None else [os.path.abspath(text) if os.path.isfile(text) else text]
    return ":".join(words)


def parse(text: str) -> List[Tuple[str, str]]:
    """Return [(name, specification), ...] of a comma-separated list. Names are what trials.csv shows.

    A file is called by its name without folder and ending, a person's own class by its name. Raises ApplrError.
    """
    methods: Dict[str, str] = {}
    for spec in (part.strip() for part in text.split(",")):
        user = USER_METHOD.match(spec)
        name = user.group(2) if user else os.path.splitext(os.path.basename(spec))[0]
        if not NAME.match(name):
            raise ApplrError("method %r cannot be called %r: use letters, digits and ._:+-" % (spec[:80], name[:80]))
        if name in methods:
            raise ApplrError("two methods are called %r: copy the file of one to another name" % name)
        methods[name] = spec
    return list(methods.items())
