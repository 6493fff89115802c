"""Parameters of move_base: declarations, checks, current values, generated tables and .cfg files."""
