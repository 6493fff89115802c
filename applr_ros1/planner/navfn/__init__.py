"""The global planner of navfn: a potential flooded from the robot's cell, and the gradient path through it."""
