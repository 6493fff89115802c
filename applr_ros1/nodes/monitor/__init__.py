"""The node collision_monitor, between a source of velocities and the base."""
