"""The node move_base: the surface of the C++ one around planner.move_base.MoveBase."""
