"""The costmap of costmap_2d: grid arithmetic, footprints, the obstacle layer fed by laser scans, and inflation."""
