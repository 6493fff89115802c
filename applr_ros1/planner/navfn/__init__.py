"""Global planner navfn: a potential propagated from the robot, and the gradient path through it."""
# Import rule: of this repository, modules here import only costmap/ and common.
