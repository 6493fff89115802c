"""Training and evaluation: the commands, and their parts in subpackages."""
# Import rule: of this repository, modules here import only every package except nodes, and no ROS.
