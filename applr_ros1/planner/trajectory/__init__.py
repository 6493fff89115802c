"""TrajectoryPlannerROS of base_local_planner: sampled velocities, scored roll-outs, and the choice among them."""
# Import rule: of this repository, modules here import only costmap/ and the modules that both local planners share.
