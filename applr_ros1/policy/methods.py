"""Methods that choose the planner's parameters, used by both the nodes and the evaluation.

A user-defined method is a subclass of Method in any module:

    from applr_ros1.policy.methods import Method
    from applr_ros1.policy.parameter_space import SPACE

    class Cautious(Method):
        # Called at the start of a course, to seed all random draws; may be left out.
        def reset(self, seed):
            pass

        # Called at every decision; see Context.
        def theta(self, context):
            is_near = context.ranges.min() < 0.4
            # Other parameters keep their values of theta_0.
            return SPACE.from_dict({"max_vel_x": 0.3 if is_near else 1.0})

It is named as `./applr evaluate --methods my_module:Cautious`, and as `method:=my_module:Cautious`.
The class may also be in a file: `my_methods.py:Cautious`. The returned parameters are clipped to
the space's bounds, and NaN is rejected.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import sys
from types import ModuleType
from typing import Any, Callable, Dict, List, Optional, Set, Tuple

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
# Files of policy, tuned parameter set and APPLD's contexts in a robot's folder
POLICY = "applr.safetensors"
SET = "static.json"
CONTEXTS = "appld.safetensors"
# Specification my_file.py:Class or module:Class
USER_METHOD = re.compile(r"^(.+\.py|[A-Za-z_][\w.]*):([A-Za-z_]\w*)$")
# First numbers of the seeds, so that methods with the same seed draw different numbers
UNIFORM_SEED = 0x7A4D
AROUND_SEED = 0xE401


class FixedParameters(Method):
    """Constant parameter set.

    Args:
        values: (n,) parameters within the ranges.
        space: Parameter space.
        redraws_stalled: Whether other parameters are drawn in a stall (Method.redraws_stalled).
        obstacle_range: Range [m] for which the set was made (Method.obstacle_range).
    """

    static = True

    def __init__(
        self,
        values: Array,
        space: Space = SPACE,
        redraws_stalled: bool = True,
        obstacle_range: Optional[float] = None,
    ):
        self.redraws_stalled = redraws_stalled
        self.obstacle_range = obstacle_range
        self.values = np.array(values, dtype=np.float64)
        self.space = space

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

    redraws_stalled = False

    def __init__(self, space: Space = SPACE, around: Optional[FixedParameters] = None) -> None:
        self.space = space
        self.around = around
        if around is not None:
            self.period = 1.0
            self.obstacle_range = around.obstacle_range
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Seed the draws of a new course."""
        distribution_seed = UNIFORM_SEED if self.around is None else AROUND_SEED
        self._draws = np.random.default_rng([seed, distribution_seed])

    def theta(self, context: Optional[Context]) -> Array:
        """Return a new random parameter set."""
        if self.around is None:
            return self.space.to_theta(self._draws.uniform(-1.0, 1.0, len(self.space)))
        mean_action = self.space.to_action(self.around.values)
        noise = EXPLORED * self._draws.normal(size=len(self.space))
        return self.space.to_theta(mean_action + noise)

    def describe(self) -> Dict[str, Any]:
        """Return the distribution of the draws."""
        if self.around is None:
            return {"parameters": "uniform in the ranges, drawn every step"}
        return {**self.around.describe(), "explored": EXPLORED}


def shipped(name: str, robot: Robot) -> str:
    """Return the path of a method's file in the robot's folder, whether it exists or not."""
    return os.path.join(robot.folder, name)


def auto(robot: Robot) -> str:
    """Return the method for `auto`: policy, else tuned parameter set, else default parameters."""
    for method_name, file_name in (("applr", POLICY), ("static", SET)):
        if os.path.exists(shipped(file_name, robot)):
            return method_name
    return "dwa"


def _fixed(path: str, robot: Robot) -> FixedParameters:
    space = space_of(robot)
    parameter_set = space.read(path)
    return FixedParameters(parameter_set.theta, space, obstacle_range=parameter_set.obstacle_range)


def _trained(robot: Robot) -> Method:
    command = f"./applr train --recipe jackal --robot {robot.folder}"
    # A robot without a tuned set may have none that is better than its default parameters.
    if not os.path.exists(shipped(SET, robot)):
        command += " --init-from dwa"
    remedy = f"run `{command}`, and copy best.safetensors of its folder there"
    return actor.load(_existing("applr", POLICY, robot, remedy), robot)


def _tuned(robot: Robot) -> FixedParameters:
    remedy = f"run {tuning(robot)}"
    return _fixed(_existing("static", SET, robot, remedy), robot)


def tuning(robot: Robot) -> str:
    """Return the command that may find a better set, and what to do with the set."""
    # The set of an included robot is not written into the robot's folder.
    next_step = "give the static.json that it writes if the set is clearly better"
    return f"`./applr tune {robot.folder}`, and {next_step}"


def _existing(method: str, name: str, robot: Robot, remedy: str) -> str:
    """Return the path of a method's file in the robot's folder.

    Raise ApplrError if there is none: it names a method that the robot has, and the remedy.
    """
    file_path = shipped(name, robot)
    if not os.path.exists(file_path):
        problem = f"{method}: there is no {file_path}"
        raise ApplrError(f"{problem}: choose the method {auto(robot)}, or {remedy}")
    return file_path


def _explored(robot: Robot) -> Method:
    parameters = _default(robot)
    if os.path.exists(shipped(SET, robot)):
        parameters = _tuned(robot)
    return RandomParameters(space_of(robot), parameters)


def _default(robot: Robot) -> FixedParameters:
    space = space_of(robot)
    # The baseline: the planner as it is, throughout.
    return FixedParameters(space.from_dict({}), space, redraws_stalled=False)


METHODS: Dict[str, Tuple[Callable[[Robot], Method], str]] = {
    "dwa": (_default, "the planner's default parameters, theta_0"),
    "auto": (
        lambda robot: make(auto(robot), robot),
        "applr if the robot's folder has a policy, else static if it has a tuned set, else dwa",
    ),
    "static": (_tuned, "the best constant parameter set that CMA-ES found on the training worlds"),
    "random": (
        lambda robot: RandomParameters(space_of(robot)),
        "uniform over the ranges, at every decision",
    ),
    "explore": (
        _explored,
        "random around the robot's tuned set, else its default parameters, every second",
    ),
    "applr": (_trained, "the robot's policy"),
    "appld": (
        lambda robot: actor.load(shipped(CONTEXTS, robot), robot),
        "the shipped contexts and classifier",
    ),
}
# Reader by ending
FILES: Dict[str, Callable[[str, Robot], Method]] = {".safetensors": actor.load, ".json": _fixed}
SPECIFICATIONS = (
    f"{', '.join(METHODS)}, policy (.safetensors), parameter set (.json), module:Class or "
    "my_file.py:Class"
)


def make(spec: str, robot: Robot = JACKAL, user_code: bool = True) -> Method:
    """Make the method of a specification.

    Raises ApplrError if it is unknown, invalid or for another robot.

    Args:
        spec: One of SPECIFICATIONS.
        robot: Robot that the method drives.
        user_code: Whether a user's module or file may be imported.
    """
    user_class = USER_METHOD.match(spec)
    if spec in METHODS:
        constructor, _ = METHODS[spec]
        method = constructor(robot)
    elif user_class and not user_code:
        # A message to the node may not choose what it imports.
        raise ApplrError(f"method {spec} is user code: start the node with _method:={spec}")
    elif user_class:
        method = make_user_method(*user_class.groups())
    else:
        read = _reader(spec)
        method = read(spec, robot)
    method = for_robot(method, robot)
    if method.space.robot != robot.name:
        raise ApplrError(
            f"method {spec} is for the robot {method.space.robot}: this robot is {robot.name}"
        )
    # What drives, for tables and messages
    method.name = auto(robot) if spec == "auto" else spec
    return method


def obstacle_range(spec: str, robot: Robot) -> Optional[float]:
    """Return the range [m] with which move_base must start for a method (Method.obstacle_range).

    It is None for user code, which is not imported, and for a method that cannot be made: the applr
    node then says so, and drives with the default parameters.
    """
    try:
        return make(spec, robot, user_code=False).obstacle_range
    except ApplrError:
        return None


def obstacle_ranges(robot: Robot) -> Set[float]:
    """Return the ranges [m] for which a robot's tuned set and its policy were made."""
    ranges = {obstacle_range(spec, robot) for spec in ("static", "applr")}
    return {needed_range for needed_range in ranges if needed_range is not None}


def for_robot(method: Method, robot: Robot) -> Method:
    """Return the method with the robot's space and layout, unless it defines its own."""
    for attribute_name, value_of in (("space", space_of), ("layout", layout_of)):
        # Own values are in the object or in its class.
        is_inherited = attribute_name not in vars(method)
        default = getattr(Method, attribute_name)
        if is_inherited and getattr(method, attribute_name) is default:
            setattr(method, attribute_name, value_of(robot))
    return method


def _reader(spec: str) -> Callable[[str, Robot], Method]:
    file_ending = os.path.splitext(spec)[1]
    if file_ending not in FILES:
        raise ApplrError(f"method {spec!r} is unknown: give {SPECIFICATIONS}")
    return FILES[file_ending]


def absolute(spec: str) -> str:
    """Return a specification that is valid in any folder.

    Files and modules of the current folder become paths.
    """
    if spec in METHODS:
        return spec
    user_class = USER_METHOD.match(spec)
    if not user_class:
        _reader(spec)  # Raises ApplrError if the specification is not a method's file.
        return os.path.abspath(spec)
    module_name, class_name = user_class.groups()
    if module_name.endswith(".py"):
        module_name = os.path.abspath(module_name)
    elif os.path.isfile(module_name + ".py"):
        module_name = os.path.abspath(module_name + ".py")
    return f"{module_name}:{class_name}"


def parse(text: str) -> List[Tuple[str, str]]:
    """Parse a comma-separated list of specifications into [(name, specification), ...].

    The names are those in trials.csv.

    The name of a file is its base name without the ending. The name of a user's class is the class
    name.

    Raises:
        ApplrError: A name is invalid or not unique.
    """
    methods = {}
    for spec in map(str.strip, text.split(",")):
        user_class = USER_METHOD.match(spec)
        if user_class:
            method_name = user_class.group(2)
        else:
            method_name = os.path.splitext(os.path.basename(spec))[0]
        if not NAME.match(method_name):
            problem = f"method {spec[:80]!r} cannot be called {method_name[:80]!r}"
            raise ApplrError(f"{problem}: use letters, digits and ._:+-")
        if method_name in methods:
            raise ApplrError(f"two methods are called {method_name!r}: rename one of the files")
        methods[method_name] = spec
    return list(methods.items())


def make_user_method(module: str, name: str) -> Method:
    """Make an instance of class `name` of a module or a .py file.

    Raises ApplrError if it cannot be made.
    """
    base_class = "applr_ros1.policy.methods.Method"
    try:
        loaded_module = load_module(module)
        has_class = hasattr(loaded_module, name)
        method = getattr(loaded_module, name)() if has_class else None
    except Exception as error:  # The code of a user may raise anything.
        raise ApplrError(f"method {module}:{name} cannot be made: {one_line(error)}") from error
    if not has_class:
        class_names = _own_methods(loaded_module)
        remedy = f"give {' or '.join(class_names)}"
        if not class_names:
            remedy = f"derive one from {base_class}"
        raise ApplrError(f"method {module}:{name}: {module} has no class {name}: {remedy}")
    if not isinstance(method, Method):
        raise ApplrError(
            f"method {module}:{name} is not a subclass of {base_class}: derive it from that class"
        )
    return method


def _own_methods(module: ModuleType) -> List[str]:
    """Return the names of a user's classes in a module that are methods."""
    class_names = []
    for name, value in vars(module).items():
        is_method = isinstance(value, type) and issubclass(value, Method)
        # A user's module imports classes of this package to derive from them.
        if is_method and not value.__module__.startswith("applr_ros1."):
            class_names.append(name)
    return class_names


def load_module(module: str) -> ModuleType:
    """Import a module by file, or by name from the current folder or sys.path.

    It may import modules beside it.
    """
    is_file = module.endswith(".py")
    module_path = os.path.realpath(module)
    folder = os.getcwd()
    if is_file:
        folder = os.path.dirname(module_path)
    # At the end: a user's file must not hide a package of the same name.
    if folder not in sys.path:
        sys.path.append(folder)
    if not is_file:
        return importlib.import_module(module)
    # The whole path makes the name unique.
    module_name = module_path[: -len(".py")].replace(".", "_").replace(os.sep, "_")
    if module_name not in sys.modules:
        import_spec: Any = importlib.util.spec_from_file_location(module_name, module_path)
        sys.modules[module_name] = importlib.util.module_from_spec(import_spec)
        try:
            import_spec.loader.exec_module(sys.modules[module_name])
        except BaseException:  # A half-loaded module must not be found by the next attempt.
            del sys.modules[module_name]
            raise
    return sys.modules[module_name]
