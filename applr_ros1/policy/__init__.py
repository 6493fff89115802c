"""Parameter policy: parameter space, observations, actor, and other methods that choose parameters."""
# Import rule: of this repository, modules here import only robots, planner/costmap and common; no ROS, no torch.
