"""Costmap as in costmap_2d: grid, footprint, and the static, obstacle and inflation layers."""
