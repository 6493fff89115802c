"""The local planner of dwa_local_planner/DWAPlannerROS: sampled velocities, seven critics, stop and turn."""
