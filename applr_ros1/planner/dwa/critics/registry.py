"""All critics of DWAPlannerROS, in the order of the C++ planner.

A new critic needs its file (see this package), and its entry in CRITICS.
"""

import inspect
from math import nan
from typing import Any, Callable, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics import (
    alignment,
    goal,
    goal_front,
    obstacle,
    oscillation,
    path,
    twirling,
)
from applr_ros1.planner.dwa.critics.critic import Critic
from applr_ros1.planner.dwa.critics.distance import at_end
from applr_ros1.planner.sampling_planner import Record, record

CRITICS: Tuple[Critic, ...] = (
    oscillation.CRITIC,
    obstacle.CRITIC,
    goal_front.CRITIC,
    alignment.CRITIC,
    path.CRITIC,
    goal.CRITIC,
    twirling.CRITIC,
)
ALL = len(CRITICS)
OBSTACLE = CRITICS.index(obstacle.CRITIC)

# Critics that read a distance grid: number in CRITICS, and GridReading
READERS = np.array(
    [(number, *critic.grid, 0) for number, critic in enumerate(CRITICS) if critic.grid],
    record("", "critic row at_nose refuses limit"),
)


def _call(critic: Critic, kernel_name: str) -> str:
    """Return the call of a kernel of a critic's file, with the arguments that it names."""
    critic_kernel = getattr(globals()[critic.term.name], kernel_name)
    arguments = ", ".join(inspect.signature(critic_kernel).parameters)
    return f"{critic.term.name}.{kernel_name}({arguments})"


def _weight(critic: Critic) -> str:
    """Return the expression of a critic's weight."""
    return f"p.{critic.scale}" if critic.scale else "1.0"


def _value(critic: Critic) -> str:
    """Return the expression of a critic's value."""
    if critic.grid is None:
        return _call(critic, "value")
    nose_offset = "p.forward_point_distance" if critic.grid.at_nose else "0.0"
    return f"at_end(scene, grids, {critic.grid.row}, points, {nose_offset}, {critic.grid.refuses})"


def _bound(number: int, critic: Critic) -> str:
    """Return the expression of a lower bound of a critic's value."""
    if hasattr(globals()[critic.term.name], "bound"):
        return _call(critic, "bound")
    return f"known_of[sample, {number}]"


def _generated(header: str, body: str, **options: Any) -> Callable[..., Any]:
    """Return a kernel of this module, from text: numba cannot loop over the critics' kernels.

    Args:
        header: Its name, with the names of its arguments.
        body: Its lines, made of the critics.
        options: Options of `kernel`.
    """
    namespace = dict(globals(), at_end=at_end, nan=nan)
    exec(f"def {header}:\n{body}", namespace)
    return kernel(namespace[header.partition("(")[0]], **options)


_WEIGHTS = ", ".join(map(_weight, CRITICS))
_VALUES = "\n".join(
    f"    if critic == {number}:\n        return {_value(critic)}"
    for number, critic in enumerate(CRITICS)
)
# In the order of total_cost, so that the roundings are the same
_BOUNDS = " + ".join(
    f"{_bound(number, critic)} * {_weight(critic)}" for number, critic in enumerate(CRITICS)
)

# Critics' weights (ALL,) of a PARAMETERS record. A critic of weight 0 is not asked: it refuses
# nothing.
weights: Callable[[Record], Tuple[float, ...]] = _generated("weights(p)", f"    return {_WEIGHTS}")

# Value of a critic, by its number, for a trajectory. state: STATE record. points: poses (k, 3) of
# the trajectory; without any, the map's critics return 0. velocity: velocity that the trajectory
# stores (samples.commanded).
value: Callable[..., float] = _generated(
    "value(p, state, scene, grids, points, velocity, critic)", f"{_VALUES}\n    return nan"
)

# Lower bound of the weighted sum for a sample that no critic has refused so far. known_of: see
# DWAScratch. sample: its number. velocity: see value.
lower_bound: Callable[..., float] = _generated(
    "lower_bound(p, known_of, sample, velocity)", f"    return {_BOUNDS}", inline="always"
)
