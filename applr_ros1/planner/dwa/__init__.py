"""DWAPlannerROS of dwa_local_planner: sampled velocities, seven critics, stopping and turning at the goal."""
# This package imports costmap/, parameters/ and the modules that both local planners share.
