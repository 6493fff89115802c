"""The node move_base: topics, services and actions of the C++ one around planner.move_base.MoveBase."""
# Imports planner, robots and what nodes share.
