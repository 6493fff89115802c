"""DWAPlannerROS of dwa_local_planner: sampled velocities, seven critics, stop and turn at goals."""
