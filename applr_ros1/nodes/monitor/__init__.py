"""The node collision_monitor, between a source of velocities and the base, and its guard."""
# Imports monitor, robots and the shared modules of nodes.
