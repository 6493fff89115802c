"""The node movers: moving obstacles and where they will be, for costmaps, policy and display."""
# Imports movers, robots and what nodes share.
