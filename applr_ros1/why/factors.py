"""Other values of one parameter: the table from which robot and desk propose changes."""

from __future__ import annotations

from typing import Any, List

from applr_ros1.planner.parameters.parameter import Parameter
from applr_ros1.planner.parameters.settings import ratio_of

FACTORS = 0.5, 2.0  # changes of a value that are tried, beside the default of the C++ planner
LEAST_CHANGE = 0.1  # smallest relative change that is tried
# What the owner wants. A drive that only takes less time because it may is not better.
WISHES = (
    # The speed that is wanted, or that is too slow
    "max_vel_x",
    "max_vel_trans",
    "min_vel_x",
    "min_vel_trans",
    "escape_vel",
    # When a goal is reached
    "xy_goal_tolerance",
    "yaw_goal_tolerance",
)
# Parameters that cannot free a robot with differential drive
FUTILE = (
    "restore_defaults",
    "enabled",
    "acc_lim_y",
    "vy_samples",
    "holonomic_robot",
    "dwa",
    "use_dwa",
    "prune_plan",
    "publish_cost_grid_pc",
    "publish_traj_pc",
)


def values_to_try(parameter: Parameter, value: Any) -> List[Any]:
    """Return the values to try instead of one, the nearest first: C++'s default, half and twice it.

    None of them lies beyond the default, where a change that helps is rarely found first. There are
    none for WISHES and FUTILE parameters.
    """
    if parameter.name in WISHES + FUTILE:
        return []
    default = parameter.default
    values = {default}
    if not isinstance(value, bool):
        for factor in FACTORS:
            other_value = parameter.convert(value * factor)
            if min(value, other_value) < default < max(value, other_value):
                other_value = default
            values.add(parameter.clamp(other_value))
    least_change = 0.0
    if isinstance(value, float):
        least_change = LEAST_CHANGE * abs(value)
    other_values = []
    for other_value in sorted(values):
        if other_value != value and abs(other_value - value) >= least_change:
            other_values.append(other_value)
    return sorted(other_values, key=lambda other_value: ratio_of(value, other_value))
