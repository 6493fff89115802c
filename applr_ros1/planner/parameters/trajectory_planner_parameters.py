"""Parameters of the local planner TrajectoryPlannerROS.

Combined in declarations.py. Uses only the standard library because the .cfg files import it at
build time.
"""

from __future__ import annotations

import math
from typing import Iterator

from applr_ros1.planner.parameters.parameter import (
    GOAL,
    INF,
    RECOVERY,
    RESTORE,
    flag,
    real,
    text,
    too_many_points,
    whole,
)
from applr_ros1.planner.parameters.trees import Tree

# Columns: name, default, minimum, maximum, unit, description; for flags, texts and lists only name,
# default, description
# fmt: off
# Parameters that dynamic_reconfigure can change
TRAJECTORY_PLANNER = (
    real("acc_lim_x", 2.5, 0.0, 20.0, "m/s^2",
        "Forward acceleration limit of the trajectory simulation.", older=("acc_limit_x",),
        once=(GOAL,)),
    real("acc_lim_y", 2.5, 0.0, 20.0, "m/s^2",
        "Sideways acceleration limit. No effect: the base cannot strafe, and a measured sideways "
        "velocity is taken as 0.", older=("acc_limit_y",), once=(GOAL,)),
    real("acc_lim_theta", 3.2, 0.0, 20.0, "rad/s^2",
        "Angular acceleration limit of the trajectory simulation.",
        older=("acc_limit_th", "acc_lim_th"), once=(GOAL, RECOVERY)),
    real("max_vel_x", 0.55, 0.0, 20.0, "m/s",
        "Largest forward velocity that is sampled.", kind="speed"),
    real("min_vel_x", 0.0, 0.0, 20.0, "m/s",
        "Smallest forward velocity that is sampled.", kind="speed"),
    real("max_vel_theta", 1.0, 0.0, 20.0, "rad/s",
        "Largest angular velocity to the left that is sampled.", kind="turn", once=(RECOVERY,)),
    real("min_vel_theta", -1.0, -20.0, 0.0, "rad/s",
        "Largest angular velocity to the right that is sampled, as a negative number.",
        kind="turn"),
    real("min_in_place_vel_theta", 0.4, 0.0, 20.0, "rad/s",
        "Smallest angular velocity, in either direction, of a turn in place.",
        kind="turn", once=(GOAL, RECOVERY)),
    real("sim_time", 1.7, 0.0, 10.0, "s",
        "Duration for which each sampled velocity is simulated.", not_zero=True, kind="time"),
    real("sim_granularity", 0.025, 0.0, 5.0, "m",
        "Distance between two simulated points of a trajectory.", not_zero=True),
    real("angular_sim_granularity", 0.025, 0.0, math.pi / 2, "rad",
        "Rotation between two simulated points of a trajectory.", not_zero=True),
    real("path_distance_bias", 0.6, 0.0, 5.0, "",
        "Cost weight of the distance between the end of a trajectory and the global plan.",
        aliases=("pdist_scale",), kind="weight"),
    real("goal_distance_bias", 0.8, 0.0, 5.0, "",
        "Cost weight of the distance between the end of a trajectory and the local goal.",
        aliases=("gdist_scale",), kind="weight"),
    real("occdist_scale", 0.01, 0.0, 5.0, "",
        "Cost weight of the largest costmap value along a trajectory."),
    real("oscillation_reset_dist", 0.05, 0.0, 5.0, "m",
        "Distance that the robot has to move before a turning direction that was blocked because "
        "of oscillation is allowed again."),
    real("escape_reset_dist", 0.1, 0.0, 5.0, "m",
        "Distance after which the robot stops backing out of a dead end.", kind="length"),
    real("escape_reset_theta", math.pi / 2, 0.0, 5.0, "rad",
        "Rotation after which the robot stops backing out of a dead end."),
    whole("vx_samples", 20, 1, 300, "",
        "Number of forward velocities sampled in a control cycle.", kind="count"),
    whole("vtheta_samples", 20, 1, 300, "",
        "Number of angular velocities sampled in a control cycle.", kind="count"),
    real("heading_lookahead", 0.325, 0.0, 5.0, "m",
        "Distance from the robot to the point at which a turn in place is scored, ahead of the "
        "robot after the turn."),
    flag("holonomic_robot", True,
        "No effect; kept for clients of the C++ node. A differential-drive base is always "
        "assumed."),
    real("escape_vel", -0.1, -2.0, 2.0, "m/s",
        "Forward velocity while backing out of a dead end; negative values drive backwards.",
        kind="speed", older=("backup_vel",)),
    flag("dwa", False,
        "Whether only velocities that can be reached within one control period are sampled "
        "(dynamic window). If false, velocities that can be reached within sim_time are sampled."),
    flag("heading_scoring", False,
        "Whether trajectories are scored by their heading relative to the plan instead of by their "
        "distance from it."),
    real("heading_scoring_timestep", 0.1, 0.0, 1.0, "s",
        "Time along a trajectory at which heading_scoring evaluates the heading."),
    flag("simple_attractor", False,
        "Whether the robot heads straight for the last point of the local plan instead of "
        "following the plan."),
    text("y_vels", "-0.3,-0.1,0.1,-0.3",
        "Sideways velocities of holonomic bases. No effect; kept for clients of the C++ node."),
    RESTORE,
)

# Read once, when the node starts
STATIC_TRAJECTORY_PLANNER = (
    real("xy_goal_tolerance", 0.1, 0.0, INF, "m",
        "Distance from the goal position within which the position counts as reached.",
        beyond="error"),
    real("yaw_goal_tolerance", 0.05, 0.0, INF, "rad",
        "Difference from the goal heading within which the heading counts as reached.",
        beyond="error"),
    flag("latch_xy_goal_tolerance", False,
        "Whether the goal position, once reached, remains reached while the robot turns to the "
        "goal heading."),
    flag("prune_plan", True, "Whether points of the plan that the robot has passed are removed."),
    real("max_rotational_vel", 1.0, 0.0, INF, "rad/s",
        "Largest angular velocity of the turn to the goal heading.", kind="turn"),
    flag("meter_scoring", False,
        "Whether path_distance_bias and goal_distance_bias apply to distances in metres instead of "
        "in cells."),
    real("controller_frequency", 20.0, 0.0, INF, "Hz",
        "Control rate for which the dynamic window is computed."),
    real("min_in_place_rotational_vel", 0.4, -INF, INF, "rad/s",
        "Older name of min_in_place_vel_theta. If only the older name is given, it applies to the "
        "turn to the goal heading, as in C++, and with another local planner also to rotations of "
        "recovery.", kind="turn"),
    text("world_model", "costmap", "Representation of obstacles. Only costmap is supported."),
    flag("publish_cost_grid_pc", False,
        "Whether the cost grid is published as the point cloud cost_cloud for RViz."),
)
# fmt: on


def contradictions(values: Tree) -> Iterator[str]:
    """Yield a message for each value that conflicts with the others.

    With heading_scoring, points are sim_granularity [s] apart, as if at a speed of 1.
    """
    speeds = ("max_vel_x", "min_vel_x", "escape_vel", "heading_scoring")
    yield from too_many_points(values, "sim_granularity", speeds, values["sim_time"])
    turns = ("max_vel_theta", "min_vel_theta", "min_in_place_vel_theta")
    yield from too_many_points(values, "angular_sim_granularity", turns)
    if values.get("world_model", "costmap") != "costmap":
        yield f"world_model is {values['world_model']}: give costmap"
