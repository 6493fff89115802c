"""Global planner navfn: a potential flooded from the robot, and the gradient path through it."""
# Imports costmap/ and common.
