"""DWAPlannerROS of dwa_local_planner: sampled velocities, critics, stop and turn at goals."""
