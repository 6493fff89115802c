"""TrajectoryPlannerROS of base_local_planner: sampled velocities, scored roll-outs, choice."""
