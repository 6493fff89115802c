"""TrajectoryPlannerROS of base_local_planner: sampled velocities, scored roll-outs, and the choice among them."""
# This package imports costmap/ and the modules that both local planners share.
