"""DWAPlannerROS of dwa_local_planner: sampled velocities, seven critics, stopping and turning at the goal."""
# Import rule: of this repository, modules here import costmap/, parameters/ and what both local planners share.
