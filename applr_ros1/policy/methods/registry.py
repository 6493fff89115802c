"""Methods by name, for launch modes and for evaluation alike: make("applr"), make("frozen:vx_samples:applr")."""

from __future__ import annotations

import os
import re
from typing import Callable, Dict, List, Tuple

from applr_ros1.planner.variant import PER_METRE
from applr_ros1.policy.actor import Actor
from applr_ros1.policy.appld import Appld, Published
from applr_ros1.policy.distance_weights import weights_of_set
from applr_ros1.policy.methods.included import (
    FixedParameters,
    FrozenParameter,
    ObservationPolicy,
    RandomParameters,
    at_period,
)
from applr_ros1.policy.methods.own import make_own
from applr_ros1.policy.methods.protocol import Method, MethodError
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot

NAME = re.compile(r"^[\w.:+-]{1,60}$", re.ASCII)  # of a method in trials.csv
OWN = re.compile(r"^(.+\.py|[A-Za-z_][\w.]*):([A-Za-z_]\w*)(?::(.*))?$")  # my_file.py:Class:text, module:Class:text
MODES = ("applr", "dwa", "appld", "fixed", "random")  # launch modes; each other method is one, too


def shipped(name: str = "applr.safetensors", robot: Robot = JACKAL) -> str:
    """Path of a robot's own model: in its folder, else, for the Jackal, the one that comes with the package.

    The latter lies beside the code, or below share/ of an install space.
    """
    own = os.path.join(robot.folder, name)
    if robot.name != JACKAL.name or os.path.exists(own):
        return own
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    prefix = os.path.join(package, *[os.pardir] * 4)
    for folder in (package, os.path.join(prefix, "share", "applr_ros1", "applr_ros1")):
        path = os.path.normpath(os.path.join(folder, "models", name))
        if os.path.exists(path):
            return path
    return os.path.join(package, "models", name)


def _actor(path: str, robot: Robot) -> Method:
    return ObservationPolicy(Actor.load(path, space_of(robot)), path)


def _appld(path: str, robot: Robot) -> Method:
    space = space_of(robot)
    if path == "published":
        return ObservationPolicy(Published(space))
    return ObservationPolicy(Appld.load(path, space), path)


def _fixed(path: str, robot: Robot) -> Method:
    if not path:
        raise MethodError('method fixed has no set of parameters: give a JSON file such as {"max_vel_x": 1.0}')
    space = space_of(robot)
    return FixedParameters(space.read(path), weights_of_set(path), space)


def _named(values: Dict[str, float], robot: Robot) -> Method:
    space = space_of(robot)
    return FixedParameters(space.from_dict(values), space=space)


def _for_two_seconds(robot: Robot) -> str:
    """The policy file that is meant for a decision every 2 s, where the robot has one; else its shipped policy."""
    own = shipped("applr_2s.safetensors", robot)
    return own if os.path.exists(own) else shipped(robot=robot)


METHODS: Dict[str, Tuple[Callable[[Robot], Method], str]] = {
    "dwa": (lambda robot: _named({}, robot), "the planner's default parameters, theta_0"),
    "fast_dwa": (
        lambda robot: _named({"max_vel_x": 1.0, "vx_samples": 12}, robot),
        "theta_0 with max_vel_x 1.0 and 12 vx samples, as in the BARN Challenge",
    ),
    "static": (
        lambda robot: _fixed(shipped("static.json", robot), robot),
        "the best single set that CMA-ES found on the training worlds; evaluation takes static_per_metre where the "
        "distance weights count metres",
    ),
    "static_per_metre": (
        lambda robot: _fixed(shipped("static_per_metre.json", robot), robot),
        "the best single set for a planner whose distance weights count metres",
    ),
    "random": (lambda robot: RandomParameters(space_of(robot)), "uniform over the ranges, every step"),
    "applr": (
        lambda robot: _actor(shipped(robot=robot), robot),
        "the robot's shipped policy; the Jackal's decides every second",
    ),
    "applr_2s": (
        lambda robot: at_period(_actor(_for_two_seconds(robot), robot), "2"),
        "the paper's decision period of 2 s: the Jackal's policy for it, another robot's shipped policy as it is",
    ),
    "appld": (
        lambda robot: _appld(shipped("appld.safetensors", robot), robot),
        "the shipped contexts and classifier",
    ),
    "appld:published": (
        lambda robot: _appld("published", robot),
        "the authors' published sets, with a rule of ours that chooses",
    ),
}
FILES: Dict[str, Callable[[str, Robot], Method]] = {"applr": _actor, "appld": _appld, "fixed": _fixed}  # KIND:FILE
FORMS = (
    "%s, an actor (.safetensors), appld:FILE, a set (.json), frozen:PARAMETER:METHOD, ablation:METHOD, "
    "period:SECONDS:METHOD, module:Class or my_file.py:Class, or NAME=any of these" % ", ".join(METHODS)
)


def make(spec: str, robot: Robot = JACKAL, own: bool = True) -> Method:
    """A method by its specification (FORMS) for a robot.

    Args:
        spec: The specification.
        robot: Whose parameters the method sets.
        own: Whether a person's own module or file may be imported for it.

    Raises:
        ApplrError: Of one line; MethodError, ActorError, AppldError or SpaceError.
    """
    method = for_robot(_made(spec, robot, own), robot)
    if method.space.robot != robot.name:
        raise MethodError("method %s is for the robot %s: here %s runs" % (spec, method.space.robot, robot.name))
    return method


def for_weights(spec: str, weights: str, robot: Robot = JACKAL) -> str:
    """What a specification stands for where the planner's distance weights count so: static has a set for each kind.

    Args:
        spec: The specification of a method.
        weights: per_cell, per_metre or drawn; sets for planners that draw are those for per_cell.
        robot: Whose sets; one that has a single set has it for both kinds.
    """
    kind, _, rest = spec.partition(":")
    if kind in ("frozen", "period") and ":" in rest:
        what, _, inner = rest.partition(":")
        return "%s:%s:%s" % (kind, what, for_weights(inner, weights, robot))
    if (spec, weights) == ("static", PER_METRE) and os.path.exists(shipped("static_per_metre.json", robot)):
        return "static_per_metre"
    return spec


def for_robot(method: Method, robot: Robot) -> Method:
    """The method itself, with the robot's space and layout where it states none."""
    for name, of in (("space", space_of), ("layout", layout_of)):
        if name not in vars(method) and getattr(type(method), name) is getattr(Method, name):
            setattr(method, name, of(robot))
    return method


def _made(spec: str, robot: Robot, own: bool) -> Method:
    if spec in METHODS:
        return METHODS[spec][0](robot)
    kind, colon, rest = spec.partition(":")
    if kind == "frozen":
        name, _, inner = rest.partition(":")
        return FrozenParameter(make(inner, robot, own), name)
    if kind == "period":
        seconds, _, inner = rest.partition(":")
        return at_period(make(inner, robot, own), seconds)
    if kind in FILES and (colon or kind == "fixed"):
        return FILES[kind](rest, robot)
    match = OWN.match(spec)
    if match and not own:
        raise MethodError("method %s is code of one's own: start the node with it, as its parameter ~mode" % spec)
    if match:
        module, name, text = match.groups()
        return make_own(spec, module, name, text)
    if spec.endswith(".safetensors"):
        return _actor(spec, robot)
    if spec.endswith(".json"):
        return _fixed(spec, robot)
    raise MethodError("method %r is not known: give %s" % (spec, FORMS))


def make_mode(mode: str, policy: str = "", parameters: str = "", robot: Robot = JACKAL, own: bool = True) -> Method:
    """The method for the launch arguments `mode`, `policy` and `parameters`; "" means the package's own file.

    Args:
        mode: One of MODES, or any other specification.
        policy: File for the modes applr and appld.
        parameters: File for the mode fixed.
        robot: Whose parameters the method sets.
        own: Whether a person's own module or file may be imported for it.

    Raises:
        ApplrError: As `make` does.
    """
    file = {"applr": policy, "appld": policy, "fixed": parameters}.get(mode, "")
    method = make("%s:%s" % (mode, file) if file else mode, robot, own)
    if method.commands:
        raise MethodError("mode %s commands velocities, not parameters; start it with velocity_method.launch" % mode)
    method.name = mode
    return method


def parse(text: str, robot: Robot = JACKAL) -> List[Tuple[str, str]]:
    """[(name, specification), ...] of a comma-separated list. Names are what trials.csv shows. Raises MethodError."""
    found: List[Tuple[str, str]] = []
    for item in (part.strip() for part in text.split(",")):
        name, given, spec = item.partition("=")
        name, spec = (name, spec) if given else (_name(item), item)
        if spec.startswith("ablation:"):
            inner = spec[len("ablation:") :]
            found += [("%s-without-%s" % (_name(inner), p), "frozen:%s:%s" % (p, inner)) for p in space_of(robot).names]
        else:
            found.append((name, spec))
    for name, spec in found:
        if not NAME.match(name):
            raise MethodError("method %r cannot be called %r: use letters, digits and ._:+-" % (spec[:80], name[:80]))
        if [n for n, _ in found].count(name) > 1:
            raise MethodError("two methods are called %r: give them names, NAME=%s" % (name, spec))
    return found


def _name(spec: str) -> str:
    """What a method is called where the person gave no name."""
    if spec in METHODS:
        return spec
    if spec.startswith("frozen:"):
        parameter, _, inner = spec[len("frozen:") :].partition(":")
        return "%s-without-%s" % (_name(inner), parameter)
    if spec.startswith("period:"):
        seconds, _, inner = spec[len("period:") :].partition(":")
        return "%s-%ss" % (_name(inner), seconds)
    own = OWN.match(spec)
    if own and spec.partition(":")[0] not in FILES:
        return own.group(2)
    if spec.endswith((".safetensors", ".json")):
        return os.path.splitext(os.path.basename(spec))[0]
    return spec.split(":")[1] if ":" in spec else spec
