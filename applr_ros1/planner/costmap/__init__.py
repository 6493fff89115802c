"""The costmap of costmap_2d: grid, footprint, and the static, obstacle and inflation layers."""
# Imports common alone.
