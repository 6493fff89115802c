"""Methods: what decides over the planner's parameters in a trial. evaluate.py makes them by name; a person's own is a
class of this shape, in any module:

    class Cautious:                              # evaluate.py --methods dwa,my_module:Cautious
        def reset(self, seed): ...               # optional: a trial begins; draw randomness from this seed only
        def theta(self, context):                # every 2 s; see Context
            slow = context.ranges.min() < 0.4
            return SPACE.from_dict({"max_vel_x": 0.3 if slow else 1.0})     # names left out keep theta_0

`module:Class:text` gives the text to the constructor. What comes back is clipped to the space's bounds; NaN is refused.
"""

from __future__ import annotations

import importlib
import os
import re
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.policy import methods as modes
from applr_ros1.policy.actor import Actor
from applr_ros1.policy.appld import Appld, Published
from applr_ros1.policy.parameter_space import SPACE

MODELS = os.path.dirname(modes.shipped())
STATIC = os.path.join(MODELS, "static.json")  # best single set, with the search's log
APPLD = os.path.join(MODELS, "appld.safetensors")
NAME = re.compile(r"^[\w.:+-]{1,60}$", re.ASCII)  # of a method in trials.csv


class MethodError(ApplrError):
    """A method that cannot be had, or that misbehaves: one line."""


@dataclass(frozen=True)
class Context:
    """What a method may look at when it decides.

    observation  (729,) float32 in [-1, 1]: scan capped at 2 m, phi, theta(t-1), as the policy sees it
    ranges       (720,) float32 [m], +inf where nothing returned
    phi          angle to the local goal [rad]
    theta        (8,) what the planner has now
    time         since the goal was sent [s]
    """

    observation: np.ndarray
    ranges: np.ndarray
    phi: float
    theta: np.ndarray
    time: float


class Method:
    """reset(seed) begins a trial, theta(context) gives the next (8,). describe() goes into evaluation.json: two methods
    that describe themselves alike drive alike.
    """

    def reset(self, seed: int) -> None:
        pass

    def theta(self, context: Context) -> np.ndarray:
        raise NotImplementedError

    def describe(self) -> Dict[str, Any]:
        return {"class": type(self).__name__}


class Fixed(Method):
    """One set of parameters throughout."""

    def __init__(self, values: np.ndarray):
        self.values = SPACE.clip(values)

    def theta(self, context):
        return self.values

    def describe(self):
        return {"parameters": SPACE.as_dict(self.values)}


class Random(Method):
    """Uniform over the ranges at each step."""

    def reset(self, seed):
        self.rng = np.random.default_rng([seed, 0x7A4D])

    def theta(self, context):
        return SPACE.to_theta(self.rng.uniform(-1.0, 1.0, len(SPACE)))

    def describe(self):
        return {"parameters": "uniform in the ranges, drawn every step"}


class Policy(Method):
    """A function of the observation: an actor, or APPLD."""

    def __init__(self, policy, path: str = ""):
        self.policy, self.path = policy, path

    def theta(self, context):
        return self.policy.theta(context.observation)

    def describe(self):
        kind = {"class": type(self.policy).__name__}
        return dict(kind, file=os.path.basename(self.path), sha256=sha256(read_bytes(self.path))) if self.path else kind


class Frozen(Method):
    """Another method with one parameter held at theta_0: what share of the gain does it carry?"""

    def __init__(self, inner: Method, name: str):
        if name not in SPACE.names:
            raise MethodError("frozen:%s: no such parameter; give one of %s" % (name, ", ".join(SPACE.names)))
        self.inner, self.index, self.name = inner, SPACE.names.index(name), name
        self.reset = inner.reset

    def theta(self, context):
        theta = np.array(self.inner.theta(context), dtype=np.float64)
        theta[self.index] = SPACE.theta0[self.index]
        return theta

    def describe(self):
        return dict(self.inner.describe(), frozen=self.name)


class Own(Method):
    """A person's own class."""

    def __init__(self, made, spec: str):
        self.made, self.spec = made, spec
        if not callable(getattr(made, "theta", None)):
            raise MethodError(
                "method %s has no theta(context); see training/evaluation/methods.py for an example" % spec
            )

    def reset(self, seed):
        if hasattr(self.made, "reset"):
            self.made.reset(seed)

    def theta(self, context):
        try:
            return SPACE.clip(self.made.theta(context))
        except Exception as error:
            raise MethodError(
                "method %s gave no parameters: %s: %s"
                % (self.spec, type(error).__name__, (str(error).splitlines() or [""])[0])
            ) from error

    def describe(self):
        return self.made.describe() if hasattr(self.made, "describe") else {"class": self.spec}


def _fast() -> np.ndarray:
    return SPACE.from_dict({"max_vel_x": 1.0, "vx_samples": 12})  # the BARN Challenge's Fast-DWA


METHODS: Dict[str, Tuple[Callable[[], Method], str]] = {
    "dwa": (lambda: Fixed(SPACE.theta0), "the planner's default parameters, theta_0"),
    "fast_dwa": (lambda: Fixed(_fast()), "theta_0 with max_vel_x 1.0 and 12 vx samples, as in the BARN Challenge"),
    "static": (lambda: Fixed(SPACE.read(STATIC)), "the best single set that CMA-ES found on the training worlds"),
    "random": (Random, "uniform over the ranges, every step"),
    "applr": (lambda: Policy(Actor.load(modes.shipped()), modes.shipped()), "the shipped policy"),
    "appld": (lambda: Policy(Appld.load(APPLD), APPLD), "the shipped contexts and classifier"),
    "appld:published": (lambda: Policy(Published()), "the authors' published sets, with a rule of ours that chooses"),
}
FORMS = (
    "%s, an actor (.safetensors), appld:FILE, a set (.json), frozen:PARAMETER:METHOD, ablation:METHOD, "
    "module:Class, or NAME=any of these" % ", ".join(METHODS)
)


def make(spec: str) -> Method:
    """A method by its specification (FORMS). Raises MethodError, ActorError, AppldError or SpaceError, of one line."""
    if spec in METHODS:
        return METHODS[spec][0]()
    if spec.startswith("frozen:"):
        name, _, inner = spec[len("frozen:") :].partition(":")
        return Frozen(make(inner), name)
    if spec.startswith("appld:"):
        return Policy(Appld.load(spec[len("appld:") :]), spec[len("appld:") :])
    if spec.endswith(".safetensors"):
        return Policy(Actor.load(spec), spec)
    if spec.endswith(".json"):
        return Fixed(SPACE.read(spec))
    match = re.match(r"^([A-Za-z_][\w.]*):([A-Za-z_]\w*)(?::(.*))?$", spec)
    if match:
        return _own(spec, *match.groups())
    raise MethodError("method %r is not known: give %s" % (spec, FORMS))


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
    if spec.endswith((".safetensors", ".json")):
        return os.path.splitext(os.path.basename(spec))[0]
    if spec.startswith("frozen:"):
        parameter, _, inner = spec[len("frozen:") :].partition(":")
        return "%s-without-%s" % (_name(inner), parameter)
    return spec.split(":")[1] if ":" in spec else spec


def _own(spec: str, module: str, name: str, text) -> Method:
    try:
        made = getattr(importlib.import_module(module), name)
        return Own(made(text) if text is not None else made(), spec)
    except MethodError:
        raise
    except Exception as error:  # whatever a person's module does wrong is theirs to hear in one line
        raise MethodError(
            "method %s cannot be made: %s: %s" % (spec, type(error).__name__, (str(error).splitlines() or [""])[0])
        ) from None
