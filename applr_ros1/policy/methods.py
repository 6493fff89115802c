"""What can decide over the parameters while driving: a registry of methods, the same for every launch mode.

The applr node makes one by the launch argument `mode` and asks it every two seconds. A method added here is
at once a mode.
"""

import os

import numpy as np

from applr_ros1.policy.actor import Actor
from applr_ros1.policy.appld import Appld as Contexts
from applr_ros1.policy.appld import Published
from applr_ros1.policy.parameter_space import SPACE, SpaceError


class Method:
    """One way to choose theta. Static methods hold one set: it is applied once, and what a person changes
    later stands. mode: what the launch argument calls it. options: what the launch file gives (`policy`,
    `parameters`, `seed`).
    """

    mode = ""
    static = False

    def __init__(self, space=SPACE, **options):
        self.space = space

    def reset(self):
        """Called when a goal becomes active: a new course begins."""

    def theta(self, obs):
        """obs (729,) float32 → theta (8,) float64. Raises SpaceError when there is none to be had."""
        raise NotImplementedError


class Default(Method):
    """The paper's baseline: the planner on theta_0, all the way."""

    mode = "dwa"
    static = True

    def theta(self, obs):
        return self.space.theta0.copy()


class Applr(Method):
    """The learned policy. policy: path of an actor file, "" for the shipped one. Raises ActorError (one line)
    when it cannot be used.
    """

    mode = "applr"

    def __init__(self, space=SPACE, policy="", **options):
        super().__init__(space)
        self.actor = Actor.load(policy or shipped(), space)

    def theta(self, obs):
        return self.actor.theta(obs)


class Appld(Method):
    """The paper's second baseline: the set of the context that the scan shows. policy: an APPLD file, "" for the
    shipped one, or "published" for the authors' sets (chosen by a rule of ours: see policy/appld.py). Raises
    AppldError (one line) when it cannot be used.
    """

    mode = "appld"

    def __init__(self, space=SPACE, policy="", **options):
        super().__init__(space)
        self.contexts = (
            Published(space) if policy == "published" else Contexts.load(policy or shipped("appld.safetensors"), space)
        )

    def theta(self, obs):
        return self.contexts.theta(obs)


class Fixed(Method):
    """One set of parameters. parameters: a JSON file {name: value}; names left out keep theta_0."""

    mode = "fixed"
    static = True

    def __init__(self, space=SPACE, parameters="", **options):
        super().__init__(space)
        if not parameters:
            raise SpaceError(
                'mode fixed has no set of parameters: give parameters:=FILE, JSON such as {"max_vel_x": 1.0}'
            )
        self.values = space.read(parameters)

    def theta(self, obs):
        return self.values.copy()


class Random(Method):
    """Uniform over the ranges: for trying the stack and for gathering data. seed: int."""

    mode = "random"

    def __init__(self, space=SPACE, seed=0, **options):
        super().__init__(space)
        self.rng = np.random.default_rng(int(seed))

    def theta(self, obs):
        return self.space.to_theta(self.rng.uniform(-1.0, 1.0, len(self.space)))


METHODS = {method.mode: method for method in (Default, Applr, Appld, Fixed, Random)}


def make(name, space=SPACE, **options):
    """The method called `name`. Raises SpaceError for an unknown name; SpaceError, ActorError or
    AppldError for bad files.
    """
    if name not in METHODS:
        raise SpaceError(f"mode {name!r} is unknown: give {', '.join(sorted(METHODS))}")
    return METHODS[name](space=space, **options)


def shipped(name="applr.safetensors"):
    """Path of a model that comes with the package: beside the code, or below share/ of an install space."""
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    prefix = os.path.join(package, *[os.pardir] * 4)
    for folder in (package, os.path.join(prefix, "share", "applr_ros1", "applr_ros1")):
        path = os.path.normpath(os.path.join(folder, "models", name))
        if os.path.exists(path):
            return path
    return os.path.join(package, "models", name)
