"""DWAPlannerROS of dwa_local_planner: sampled velocities, seven critics, stopping and turning at the goal."""
