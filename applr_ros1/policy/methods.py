"""Methods that choose the planner's parameters, used by both the nodes and the evaluation.

A user-defined method is a subclass of Method in any module:

    from applr_ros1.policy.methods import Method
    from applr_ros1.policy.parameter_space import SPACE

    class Cautious(Method):                      # evaluate.py --methods my_module:Cautious; method:=my_module:Cautious
        def reset(self, seed): ...               # optional, called at the start of a course; seed all random draws
        def theta(self, context):                # called at every decision; see Context
            slow = context.ranges.min() < 0.4
            return SPACE.from_dict({"max_vel_x": 0.3 if slow else 1.0})     # other parameters keep theta_0

The class may also be in a file: `my_methods.py:Cautious`. The returned parameters are clipped to the space's bounds,
and NaN is rejected.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import sys
from types import ModuleType
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.policy import actor
from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.robots import JACKAL, Robot

EXPLORED = 0.5  # standard deviation of exploration noise on a parameter scaled to [-1, 1]
NAME = re.compile(r"^[\w.:+-]{1,60}$", re.ASCII)  # valid name of a method in trials.csv
POLICY, SET = "applr.safetensors", "static.json"  # files of policy and tuned parameter set in a robot's folder
USER_METHOD = re.compile(r"^(.+\.py|[A-Za-z_][\w.]*):([A-Za-z_]\w*)$")  # specification my_file.py:Class or module:Class


class FixedParameters(Method):
    """Constant parameter set.

    Args:
        values: (n,) parameters within the ranges.
        space: Parameter space.
        per_cell: Whether the distance biases are per costmap cell (Method.per_cell).
    """

    static = True

    def __init__(self, values: Array, space: Space = SPACE, per_cell: bool = False):
        self.values, self.space, self.per_cell = np.array(values, dtype=np.float64), space, per_cell

    def theta(self, context: Optional[Context]) -> Array:
        """Return the parameter set."""
        return self.values.copy()

    def describe(self) -> Dict[str, Any]:
        """Return the parameter set as {name: value}."""
        return {"parameters": self.space.as_dict(self.values)}


class RandomParameters(Method):
    """Random parameter sets, drawn at each decision, for tests and for training drives.

    Args:
        space: Parameter space.
        around: Mean of a normal distribution; None for a uniform distribution over the ranges.
    """

    def __init__(self, space: Space = SPACE, around: Optional[FixedParameters] = None) -> None:
        self.space, self.around = space, around
        if around is not None:
            self.period, self.per_cell = 1.0, around.per_cell
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Seed the draws of a new course."""
        self._draws = np.random.default_rng([seed, 0x7A4D if self.around is None else 0xE401])

    def theta(self, context: Optional[Context]) -> Array:
        """Return a new random parameter set."""
        if self.around is None:
            return self.space.to_theta(self._draws.uniform(-1.0, 1.0, len(self.space)))
        action = self.space.to_action(self.around.values) + EXPLORED * self._draws.normal(size=len(self.space))
        return self.space.to_theta(np.clip(action, -1.0, 1.0))

    def describe(self) -> Dict[str, Any]:
        """Return the distribution of the draws."""
        if self.around is None:
            return {"parameters": "uniform in the ranges, drawn every step"}
        return {**self.around.describe(), "explored": EXPLORED}


def shipped(name: str, robot: Robot) -> str:
    """Return the path of a method's file in the robot's folder, whether it exists or not."""
    return os.path.join(robot.folder, name)


def auto(robot: Robot) -> str:
    """Return the method for `auto`: the robot's policy, else its tuned parameter set, else its default parameters."""
    files = {"applr": POLICY, "static": SET}
    return next((name for name, file in files.items() if os.path.exists(shipped(file, robot))), "dwa")


def _fixed(path: str, robot: Robot) -> FixedParameters:
    space = space_of(robot)
    values, per_cell = space.read(path)
    return FixedParameters(values, space, per_cell)


def _trained(robot: Robot) -> Method:
    train = f", then `python -m training.train --recipe jackal --robot {robot.folder}`"
    return actor.load(_existing("applr", POLICY, robot, train), robot)


def _tuned(robot: Robot) -> FixedParameters:
    return _fixed(_existing("static", SET, robot), robot)


def _existing(method: str, name: str, robot: Robot, then: str = "") -> str:
    """Return the path of a method's file in the robot's folder. Raise ApplrError if there is none."""
    path = shipped(name, robot)
    if not os.path.exists(path):
        raise ApplrError(f"{method}: there is no {path}: run `./applr tune {robot.folder}`{then}")
    return path


def _explored(robot: Robot) -> Method:
    tuned = os.path.exists(shipped(SET, robot))
    return RandomParameters(space_of(robot), _tuned(robot) if tuned else _default(robot))


def _default(robot: Robot) -> FixedParameters:
    space = space_of(robot)
    return FixedParameters(space.from_dict({}), space)


METHODS: Dict[str, Tuple[Callable[[Robot], Method], str]] = {
    "dwa": (_default, "the planner's default parameters, theta_0"),
    "auto": (
        lambda robot: METHODS[auto(robot)][0](robot),
        "applr if the robot's folder has a policy, else static if it has a tuned set, else dwa",
    ),
    "static": (_tuned, "the best constant parameter set that CMA-ES found on the training worlds"),
    "random": (lambda robot: RandomParameters(space_of(robot)), "uniform over the ranges, at every decision"),
    "explore": (_explored, "random around the robot's tuned set, else its default parameters, every second"),
    "applr": (_trained, "the robot's policy"),
    "appld": (
        lambda robot: actor.load(shipped("appld.safetensors", robot), robot),
        "the shipped contexts and classifier",
    ),
}
FILES: Dict[str, Callable[[str, Robot], Method]] = {".safetensors": actor.load, ".json": _fixed}  # reader by ending
SPECIFICATIONS = ", ".join(METHODS) + ", policy (.safetensors), parameter set (.json), module:Class or my_file.py:Class"


def make(spec: str, robot: Robot = JACKAL, user_code: bool = True) -> Method:
    """Make the method of a specification. Raises ApplrError if it is unknown, invalid or for another robot.

    Args:
        spec: One of SPECIFICATIONS.
        robot: Robot that the method drives.
        user_code: Whether a user's module or file may be imported.
    """
    user = USER_METHOD.match(spec)
    if spec in METHODS:
        method = METHODS[spec][0](robot)
    elif user and not user_code:
        raise ApplrError("method %s is user code: start the node with _method:=%s" % (spec, spec))
    elif user:
        method = make_user_method(*user.groups())
    else:
        method = _reader(spec)(spec, robot)
    method = for_robot(method, robot)
    if method.space.robot != robot.name:
        raise ApplrError("method %s is for the robot %s: this robot is %s" % (spec, method.space.robot, robot.name))
    method.name = auto(robot) if spec == "auto" else spec
    return method


def for_robot(method: Method, robot: Robot) -> Method:
    """Set the method's space and layout to the robot's unless the method defines its own, and return it."""
    for name, of in (("space", space_of), ("layout", layout_of)):
        if name not in vars(method) and getattr(type(method), name) is getattr(Method, name):
            setattr(method, name, of(robot))
    return method


def _reader(spec: str) -> Callable[[str, Robot], Method]:
    ending = os.path.splitext(spec)[1]
    if ending not in FILES:
        raise ApplrError("method %r is unknown: give %s" % (spec, SPECIFICATIONS))
    return FILES[ending]


def absolute(spec: str) -> str:
    """Return a specification that is valid in any folder: files and modules of the current folder become paths."""
    if spec in METHODS:
        return spec
    user = USER_METHOD.match(spec)
    if not user:
        _reader(spec)  # Raises ApplrError if the specification is not a method's file.
        return os.path.abspath(spec)
    module, name = user.groups()
    file = module if module.endswith(".py") else module + ".py"
    return f"{os.path.abspath(file) if module.endswith('.py') or os.path.isfile(file) else module}:{name}"


def parse(text: str) -> List[Tuple[str, str]]:
    """Parse a comma-separated list of specifications into [(name, specification), ...], with names for trials.csv.

    The name of a file is its base name without the ending. The name of a user's class is the class name.

    Raises:
        ApplrError: A name is invalid or not unique.
    """
    methods: Dict[str, str] = {}
    for spec in (part.strip() for part in text.split(",")):
        user = USER_METHOD.match(spec)
        name = user.group(2) if user else os.path.splitext(os.path.basename(spec))[0]
        if not NAME.match(name):
            raise ApplrError("method %r cannot be called %r: use letters, digits and ._:+-" % (spec[:80], name[:80]))
        if name in methods:
            raise ApplrError("two methods are called %r: rename one of the files" % name)
        methods[name] = spec
    return list(methods.items())


def make_user_method(module: str, name: str) -> Method:
    """Make an instance of class `name` of a module or a .py file. Raises ApplrError if it cannot be made."""
    try:
        method = getattr(load_module(module), name)()
    except Exception as error:
        raise ApplrError("method %s:%s cannot be made: %s" % (module, name, one_line(error))) from error
    if not isinstance(method, Method):
        where = "applr_ros1.policy.methods.Method"
        raise ApplrError("method %s:%s is not a subclass of %s: derive it from that class" % (module, name, where))
    return method


def load_module(module: str) -> ModuleType:
    """Import a module by file, or by name from the current folder or sys.path. It may import modules beside it."""
    path = os.path.realpath(module) if module.endswith(".py") else ""
    folder = os.path.dirname(path) if path else os.getcwd()
    if folder not in sys.path:
        sys.path.append(folder)
    if not path:
        return importlib.import_module(module)
    name = path[: -len(".py")].replace(".", "_").replace(os.sep, "_")  # The whole path makes the name unique.
    if name not in sys.modules:
        spec: Any = importlib.util.spec_from_file_location(name, path)
        sys.modules[name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(sys.modules[name])
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
