"""The parameters of move_base: their declarations, checks, values in force, and generated tables and .cfg files."""
# Imports costmap/ and common.
