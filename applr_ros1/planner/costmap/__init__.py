"""Costmap as in costmap_2d: grid, footprint, and the static, obstacle and inflation layers."""
# Import rule: of this repository, modules here import only common.
