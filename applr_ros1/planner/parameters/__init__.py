"""Parameters of move_base: declarations, checks, current values and .cfg files."""
