"""Parameters of the Jackal's files, and the same parameters with DWAPlannerROS as local planner."""

import copy

from applr_ros1 import robots

JACKAL = robots.JACKAL.parameters()
JACKAL_DWA = dict(
    max_vel_trans=0.5,
    max_vel_x=0.5,
    min_vel_x=-0.1,
    max_vel_y=0.0,
    min_vel_y=0.0,
    max_vel_theta=1.57,
    min_vel_theta=0.3,
    acc_lim_x=10.0,
    acc_lim_theta=20.0,
    xy_goal_tolerance=0.25,
    yaw_goal_tolerance=0.157,
    sim_time=1.5,
    path_distance_bias=20.0,
    goal_distance_bias=24.0,
    occdist_scale=0.05,
    forward_point_distance=0.2,
    vx_samples=6,
    vth_samples=20,
)


def tree(**changes):
    made = copy.deepcopy(JACKAL)
    made.update(
        changes,
        base_local_planner="dwa_local_planner/DWAPlannerROS",
        DWAPlannerROS=dict(JACKAL_DWA),
    )
    return made
