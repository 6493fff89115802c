"""Parameter policy: parameter space, observations, actor, and other methods that choose parameters."""
# Imports robots, planner/costmap and common; no ROS, no torch.
