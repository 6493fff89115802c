"""Global planner navfn: a potential propagated from the robot, and the gradient path through it."""
