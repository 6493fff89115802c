"""Import of a robot's folder from a URDF or xacro file and the parameter files of move_base."""
