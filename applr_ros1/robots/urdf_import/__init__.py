"""A robot's folder from what its owner has: a URDF or xacro file and the parameter files of move_base."""
