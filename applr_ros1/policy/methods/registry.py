"""Methods by name, for launch modes and for evaluation alike: make("applr"), make("frozen:vx_samples:applr")."""

from __future__ import annotations

import os
import re
from typing import Callable, Dict, List, Tuple

from applr_ros1.policy.actor import Actor
from applr_ros1.policy.appld import Appld, Published
from applr_ros1.policy.distance_weights import weights_of_set
from applr_ros1.policy.methods.included import FixedParameters, FrozenParameter, ObservationPolicy, RandomParameters
from applr_ros1.policy.methods.own import make_own
from applr_ros1.policy.methods.protocol import Method, MethodError
from applr_ros1.policy.parameter_space import SPACE

NAME = re.compile(r"^[\w.:+-]{1,60}$", re.ASCII)  # of a method in trials.csv
OWN = re.compile(r"^(.+\.py|[A-Za-z_][\w.]*):([A-Za-z_]\w*)(?::(.*))?$")  # my_file.py:Class:text, module:Class:text
MODES = ("applr", "dwa", "appld", "fixed", "random")  # launch modes; each other method is one, too


def shipped(name: str = "applr.safetensors") -> str:
    """Path of a model that comes with the package: beside the code, or below share/ of an install space."""
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    prefix = os.path.join(package, *[os.pardir] * 4)
    for folder in (package, os.path.join(prefix, "share", "applr_ros1", "applr_ros1")):
        path = os.path.normpath(os.path.join(folder, "models", name))
        if os.path.exists(path):
            return path
    return os.path.join(package, "models", name)


def _actor(path: str) -> Method:
    return ObservationPolicy(Actor.load(path), path)


def _appld(path: str) -> Method:
    return ObservationPolicy(Published()) if path == "published" else ObservationPolicy(Appld.load(path), path)


def _fixed(path: str) -> Method:
    if not path:
        raise MethodError('method fixed has no set of parameters: give a JSON file such as {"max_vel_x": 1.0}')
    return FixedParameters(SPACE.read(path), weights_of_set(path))


METHODS: Dict[str, Tuple[Callable[[], Method], str]] = {
    "dwa": (lambda: FixedParameters(SPACE.theta0), "the planner's default parameters, theta_0"),
    "fast_dwa": (
        lambda: FixedParameters(SPACE.from_dict({"max_vel_x": 1.0, "vx_samples": 12})),
        "theta_0 with max_vel_x 1.0 and 12 vx samples, as in the BARN Challenge",
    ),
    "static": (lambda: _fixed(shipped("static.json")), "the best single set that CMA-ES found on the training worlds"),
    "random": (RandomParameters, "uniform over the ranges, every step"),
    "applr": (lambda: _actor(shipped()), "the shipped policy"),
    "appld": (lambda: _appld(shipped("appld.safetensors")), "the shipped contexts and classifier"),
    "appld:published": (lambda: _appld("published"), "the authors' published sets, with a rule of ours that chooses"),
}
FILES: Dict[str, Callable[[str], Method]] = {"applr": _actor, "appld": _appld, "fixed": _fixed}  # KIND:FILE
FORMS = (
    "%s, an actor (.safetensors), appld:FILE, a set (.json), frozen:PARAMETER:METHOD, ablation:METHOD, "
    "module:Class or my_file.py:Class, or NAME=any of these" % ", ".join(METHODS)
)


def make(spec: str) -> Method:
    """A method by its specification (FORMS).

    Raises:
        ApplrError: Of one line; MethodError, ActorError, AppldError or SpaceError.
    """
    if spec in METHODS:
        return METHODS[spec][0]()
    kind, colon, rest = spec.partition(":")
    if kind == "frozen":
        name, _, inner = rest.partition(":")
        return FrozenParameter(make(inner), name)
    if kind in FILES and (colon or kind == "fixed"):
        return FILES[kind](rest)
    match = OWN.match(spec)
    if match:
        module, name, text = match.groups()
        return make_own(spec, module, name, text)
    if spec.endswith(".safetensors"):
        return _actor(spec)
    if spec.endswith(".json"):
        return _fixed(spec)
    raise MethodError("method %r is not known: give %s" % (spec, FORMS))


def make_mode(mode: str, policy: str = "", parameters: str = "") -> Method:
    """The method for the launch arguments `mode`, `policy` and `parameters`; "" means the package's own file.

    Raises:
        ApplrError: As `make` does.
    """
    file = {"applr": policy, "appld": policy, "fixed": parameters}.get(mode, "")
    method = make("%s:%s" % (mode, file) if file else mode)
    if method.commands:
        raise MethodError("mode %s commands velocities, not parameters; start it with velocity_method.launch" % mode)
    method.name = mode
    return method


def parse(text: str) -> List[Tuple[str, str]]:
    """[(name, specification), ...] of a comma-separated list. Names are what trials.csv shows. Raises MethodError."""
    found: List[Tuple[str, str]] = []
    for item in (part.strip() for part in text.split(",")):
        name, given, spec = item.partition("=")
        name, spec = (name, spec) if given else (_name(item), item)
        if spec.startswith("ablation:"):
            inner = spec[len("ablation:") :]
            found += [("%s-without-%s" % (_name(inner), p), "frozen:%s:%s" % (p, inner)) for p in SPACE.names]
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
    own = OWN.match(spec)
    if own and spec.partition(":")[0] not in FILES:
        return own.group(2)
    if spec.endswith((".safetensors", ".json")):
        return os.path.splitext(os.path.basename(spec))[0]
    return spec.split(":")[1] if ":" in spec else spec
