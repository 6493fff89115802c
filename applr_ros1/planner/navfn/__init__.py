"""The global planner of navfn: a potential flooded from the goal, and the gradient path through it."""
# Imports costmap/ and common.
