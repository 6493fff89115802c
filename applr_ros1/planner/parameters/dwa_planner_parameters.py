"""Parameters of the local planner DWAPlannerROS.

Combined in declarations.py. Uses only the standard library because the .cfg files import it at
build time.
"""

from __future__ import annotations

import math
from typing import Iterator

from applr_ros1.planner.parameters.parameter import (
    INF,
    INT_MAX,
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
SAMPLES = ("vx_samples", "vy_samples", "vth_samples")
SLACK = 1e-4  # tolerance by which a sample may exceed a limit [m/s, rad/s]
MOST_SAMPLES = 1_000_000  # largest number of samples in one cycle; more would fill the memory

# Parameters that dynamic_reconfigure can change
DWA_PLANNER = (
    real("max_vel_trans", 0.55, 0.0, INF, "m/s",
        "Largest translational speed. Also the speed at which the footprint is enlarged most, see "
        "max_scaling_factor.", kind="speed", older=("max_trans_vel",)),
    real("min_vel_trans", 0.1, 0.0, INF, "m/s",
        "Smallest translational speed, except for samples that turn at min_vel_theta or faster.",
        kind="speed", older=("min_trans_vel",)),
    real("max_vel_x", 0.55, -INF, INF, "m/s",
        "Largest forward velocity that is sampled.", kind="speed"),
    real("min_vel_x", 0.0, -INF, INF, "m/s",
        "Smallest forward velocity that is sampled; a negative value lets the robot drive "
        "backwards.", kind="speed"),
    real("max_vel_y", 0.1, -INF, INF, "m/s",
        "Largest sideways velocity that is sampled. Set both sideways limits to 0 for a base that "
        "cannot strafe."),
    real("min_vel_y", -0.1, -INF, INF, "m/s",
        "Smallest sideways velocity that is sampled; negative values are to the right."),
    real("max_vel_theta", 1.0, 0.0, INF, "rad/s",
        "Largest angular velocity that is sampled, in both directions.",
        kind="turn", older=("max_rot_vel", "max_vel_rot")),
    real("min_vel_theta", 0.4, 0.0, INF, "rad/s",
        "Smallest angular velocity of a sample slower than min_vel_trans, and of the turn to the "
        "goal heading.", kind="turn", older=("min_rot_vel", "min_vel_rot")),
    real("acc_lim_x", 2.5, 0.0, 20.0, "m/s^2",
        "Forward acceleration limit of the dynamic window and of stopping at the goal."),
    real("acc_lim_y", 2.5, 0.0, 20.0, "m/s^2",
        "Sideways acceleration limit of the dynamic window and of stopping at the goal. No effect: "
        "the base cannot strafe, and a measured sideways velocity is taken as 0."),
    real("acc_lim_theta", 3.2, 0.0, 20.0, "rad/s^2",
        "Angular acceleration limit of the dynamic window and of the turn to the goal heading.",
        older=("acc_lim_th",)),
    real("acc_lim_trans", 0.1, 0.0, INF, "m/s^2",
        "No effect, as in the C++ node; kept for its clients.", older=("acc_limit_trans",)),
    flag("prune_plan", False, "Whether points of the plan that the robot has passed are removed."),
    real("xy_goal_tolerance", 0.1, -INF, INF, "m",
        "Distance from the goal position within which the position counts as reached."),
    real("yaw_goal_tolerance", 0.1, -INF, INF, "rad",
        "Difference from the goal heading within which the heading counts as reached."),
    real("trans_stopped_vel", 0.1, -INF, INF, "m/s",
        "Measured velocity along either axis up to which the robot counts as stopped."),
    real("theta_stopped_vel", 0.1, -INF, INF, "rad/s",
        "Measured angular velocity up to which the robot counts as stopped.",
        older=("rot_stopped_vel",)),
    real("sim_time", 1.7, 0.0, INF, "s",
        "Duration for which each sampled velocity is simulated. If it is 0, no velocity is legal.",
        kind="time"),
    real("sim_granularity", 0.025, 0.0, INF, "m",
        "Distance between two simulated points of a trajectory.", not_zero=True),
    real("angular_sim_granularity", 0.1, 0.0, INF, "rad",
        "Rotation between two simulated points of a trajectory.", not_zero=True),
    real("path_distance_bias", 0.6, 0.0, INF, "1/m",
        "Cost weight of the distance between the end of a trajectory and the plan. If it is 0, the "
        "path critic is off and does not reject trajectories through impassable cells.",
        kind="weight"),
    real("goal_distance_bias", 0.8, 0.0, INF, "1/m",
        "Cost weight of the distance between the end of a trajectory and the local goal.",
        kind="weight"),
    real("occdist_scale", 0.01, 0.0, INF, "",
        "Cost weight of the largest costmap value along a trajectory. If it is 0, the footprint is "
        "not checked against obstacles."),
    real("twirling_scale", 0.0, 0.0, INF, "s/rad",
        "Cost weight of the angular velocity of a trajectory."),
    real("stop_time_buffer", 0.2, 0.0, INF, "s",
        "No effect, as in the C++ node; kept for its clients."),
    real("oscillation_reset_dist", 0.05, 0.0, INF, "m",
        "Distance that the robot has to move before a direction that was blocked because of "
        "oscillation is allowed again."),
    real("oscillation_reset_angle", 0.2, 0.0, INF, "rad",
        "Rotation after which a direction that was blocked because of oscillation is allowed "
        "again."),
    real("forward_point_distance", 0.325, -INF, INF, "m",
        "Distance of a second point ahead of the robot, which is kept near the plan and driven "
        "towards the goal.", kind="length"),
    real("scaling_speed", 0.25, 0.0, INF, "m/s", "Speed above which the footprint is enlarged."),
    real("max_scaling_factor", 0.2, 0.0, INF, "",
        "Share by which the footprint is enlarged at max_vel_trans."),
    whole("vx_samples", 3, 1, INT_MAX, "",
        "Number of forward velocities sampled in a control cycle. 0 is taken as 1.",
        beyond="", kind="count"),
    whole("vy_samples", 10, 1, INT_MAX, "",
        "Number of sideways velocities sampled in a control cycle. 0 is taken as 1.", beyond=""),
    whole("vth_samples", 20, 1, INT_MAX, "",
        "Number of angular velocities sampled in a control cycle. 0 is taken as 1.",
        beyond="", kind="count"),
    flag("use_dwa", True,
        "Whether only velocities that can be reached within one control period are sampled "
        "(dynamic window). If false, velocities that can be reached within sim_time are sampled."),
    RESTORE,
)

# Read once, when the node starts
STATIC_DWA_PLANNER = (
    real("controller_frequency", 20.0, 0.0, INF, "Hz",
        "Control rate for which the dynamic window is computed. Defaults to the rate of "
        "move_base."),
    flag("sum_scores", False,
        "Whether the obstacle cost of a trajectory is the sum over its points instead of the "
        "largest value."),
    real("cheat_factor", 1.0, 0.0, INF, "",
        "The point ahead of the robot (forward_point_distance) is not kept near the plan within a "
        "distance of sqrt(cheat_factor) * forward_point_distance from the end of the local plan."),
    flag("latch_xy_goal_tolerance", False,
        "No effect, as in the C++ node, which reads the parameter of this name from move_base "
        "instead."),
    flag("publish_cost_grid_pc", False,
        "Whether the cost grid is published as the point cloud cost_cloud for RViz."),
    flag("publish_traj_pc", False,
        "Whether the points of all legal trajectories are published as the point cloud "
        "trajectory_cloud."),
    text("global_frame_id", "odom", "Not used: trajectory_cloud is in the local costmap's frame."),
    text("odom_topic", "odom", "Topic of the odometry."),
)
# fmt: on


def contradictions(values: Tree) -> Iterator[str]:
    """Yield a message for each value that leads to too many samples or points."""
    # Each axis has at least two samples and one more at zero.
    counts = tuple(values[name] for name in SAMPLES)
    sample_count = math.prod(max(n, 2) + 1 for n in counts)
    if sample_count > MOST_SAMPLES:
        problem = f"{', '.join(SAMPLES)} are {counts}, up to {sample_count} samples"
        yield f"{problem}: give at most {MOST_SAMPLES} together"
    time = values["sim_time"]
    yield from too_many_points(values, "sim_granularity", ["max_vel_trans"], time)
    yield from too_many_points(values, "angular_sim_granularity", ["max_vel_theta"], time)
