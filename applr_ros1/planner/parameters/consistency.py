"""What only shows when several parameters of a local planner are looked at together, and how finely a turn is checked.

Used by the check of parameter trees and by the requests of dynamic_reconfigure. Pure standard library.
"""

from __future__ import annotations

import math
from typing import Any, Dict

from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.parameters.parameter import ParameterError

MOST_SAMPLES = 1_000_000  # of one cycle; more are refused instead of filling the memory
MOST_POINTS = 100_000  # of one trajectory or turn; more are refused instead of taking minutes


def check_consistency(planner: str, values: Dict[str, Any]) -> None:
    """Refuse values of the local planner `planner` that cannot be run together: ParameterError, one line."""
    if planner == "DWAPlannerROS":
        _check_dwa(values)
    elif planner == "TrajectoryPlannerROS":
        _check_trajectory(values)


def check_turn(name: str, values: Dict[str, Any]) -> None:
    """Refuse a recovery behaviour whose turn would be checked at too many poses: ParameterError, one line."""
    spacing = values["sim_granularity"]
    if 2 * math.pi > MOST_POINTS * spacing:
        raise ParameterError(
            f"{name}/sim_granularity is {spacing:g}: a turn has more than {MOST_POINTS} poses, give a larger one"
        )


def _check_dwa(values):
    counts = tuple(values[name] for name in SAMPLES)
    most = math.prod(max(n, 2) + 1 for n in counts)  # each axis has two at least, and one more at zero
    if most > MOST_SAMPLES:
        raise ParameterError(
            f"{', '.join(SAMPLES)} are {counts}, up to {most} samples: give at most {MOST_SAMPLES} together"
        )
    for fastest, spacing in (("max_vel_trans", "sim_granularity"), ("max_vel_theta", "angular_sim_granularity")):
        _check_points(values, spacing, fastest, values[fastest])
    sideways = values["min_vel_y"], values["max_vel_y"]
    if sideways != (0.0, 0.0):
        raise ParameterError(f"min_vel_y, max_vel_y are {sideways}: give 0: no sideways velocity is commanded")


def _check_trajectory(values):
    if values["heading_scoring"]:
        _check_points(values, "sim_granularity", "heading_scoring, which counts seconds,", 1.0)
    for fastest in ("max_vel_x", "min_vel_x", "escape_vel"):
        _check_points(values, "sim_granularity", fastest, values[fastest])
    for fastest in ("max_vel_theta", "min_vel_theta", "min_in_place_vel_theta"):
        _check_points(values, "angular_sim_granularity", fastest, values[fastest], timed=False)


def _check_points(values, spacing, fastest, speed, timed=True):
    """Refuse trajectories of too many points. timed: whether their number grows with sim_time."""
    if abs(speed) * (values["sim_time"] if timed else 1.0) > MOST_POINTS * values[spacing]:
        time = f" and sim_time {values['sim_time']:g} s" if timed else ""
        raise ParameterError(
            f"{spacing} is {values[spacing]:g}: with {fastest} {speed:g}{time} a trajectory has more than "
            f"{MOST_POINTS} points, give a larger one"
        )
