"""A robot's folder from what its owner has: URDF or xacro, parameter files of move_base, and measured values."""
