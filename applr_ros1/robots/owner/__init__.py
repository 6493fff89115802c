"""A robot's folder from what its owner has: URDF or xacro, and parameter files of move_base."""
