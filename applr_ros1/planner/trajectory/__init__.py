"""The local planner of base_local_planner/TrajectoryPlannerROS: sampled velocities, scored roll-outs, and the choice among them."""  # noqa: E501
