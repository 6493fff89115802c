"""Parameters of move_base: declarations, checks, current values, generated tables and .cfg files."""
# Import rule: of this repository, modules here import only costmap/ and common.
