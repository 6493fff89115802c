"""The parameter policy: parameter space, observation, the actor that decides, and the other methods."""
# Imports robots, planner/costmap and common; no ROS, no torch.
