"""Parameters of a costmap, its obstacle layer with the laser scan, and its inflation layer.

Joined in declarations.py. Pure standard library: the .cfg files import this at build time.
"""

from __future__ import annotations

from applr_ros1.planner.parameters.parameter import INF, INT_MAX, flag, listing, real, text, whole

# Read the rows as: name, default, least and largest value, value on the Jackal (None: the default), unit, sentence.
# Flags, texts and lists have no bounds and no unit.
# fmt: off
PLUGINS = [
    {"name": "obstacles_layer", "type": "costmap_2d::ObstacleLayer"},
    {"name": "inflater_layer", "type": "costmap_2d::InflationLayer"},
]
COMBINATION = (
    ("Overwrite", 0, "Known cells of this layer replace those of the costmap."),
    ("Maximum", 1, "The larger value of layer and costmap is kept."),
)

# Live, through dynamic_reconfigure: the costmap, its inflation layer, its obstacle layer
COSTMAP = (
    real("transform_tolerance", 0.3, 0.0, 10.0, 0.5, "s", "Largest age at which a robot pose is still used."),
    real("update_frequency", 5.0, 0.0, 100.0, 20.0, "Hz",
        "How often the costmap is updated with the newest scan. With 0 it is never updated."),
    real("publish_frequency", 0.0, 0.0, 100.0, 5.0, "Hz",
        "Highest rate at which the costmap is published. With 0 it is never published."),
    whole("width", 10, 0, INT_MAX, 10, "m", "Size of the costmap along x.", not_zero=True),
    whole("height", 10, 0, INT_MAX, 10, "m", "Size of the costmap along y.", not_zero=True),
    real("resolution", 0.05, 0.0, 50.0, 0.05, "m", "Edge length of a cell.", not_zero=True),
    real("origin_x", 0.0, -INF, INF, 0.0, "m", "Position of the lower corner of the costmap along x."),
    real("origin_y", 0.0, -INF, INF, 0.0, "m", "Position of the lower corner of the costmap along y."),
    text("footprint", "[]", "[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]",
        "Outline of the robot as a list of points [[x, y], ...] in metres. With [] a circle of robot_radius is used."),
    real("robot_radius", 0.46, 0.0, 10.0, 0.46, "m", "Radius of a round robot, used where no footprint is given."),
    real("footprint_padding", 0.01, -INF, INF, 0.1, "m",
        "Distance by which the footprint is enlarged on every side."),
)

INFLATION = (
    flag("enabled", True, True, "Whether costs are spread around obstacles."),
    real("cost_scaling_factor", 10.0, 0.0, 100.0, 10.0, "1/m",
        "Rate at which the cost falls with the distance from an obstacle; larger values fall faster."),
    real("inflation_radius", 0.55, 0.0, 50.0, 0.3, "m", "Distance up to which an obstacle has a cost around it."),
    flag("inflate_unknown", False, False, "Whether unknown cells take inflated costs."),
)

OBSTACLES = (
    flag("enabled", True, True, "Whether the laser scan marks and clears cells."),
    flag("footprint_clearing_enabled", True, True, "Whether cells under the footprint of the robot are always free."),
    real("max_obstacle_height", 2.0, 0.0, 50.0, 2.0, "m", "Height above which points do not count as obstacles."),
    whole("combination_method", 1, -INT_MAX - 1, INT_MAX, 1, "",
        "How this layer is combined with the costmap.", enum=COMBINATION),
)

# Read once, when the node starts: the costmap, its obstacle layer, the source of the obstacle layer
STATIC_COSTMAP = (
    text("global_frame", "odom", "odom",
        "Frame of the costmap. Both costmaps have to use the same one; goals are transformed into it."),
    text("robot_base_frame", "base_link", "base_link", "Frame of the robot base."),
    flag("rolling_window", False, True, "Whether the costmap moves along with the robot."),
    flag("track_unknown_space", False, None,
        "Whether cells are unknown instead of free until the laser has observed them."),
    flag("always_send_full_costmap", False, None,
        "Whether the whole costmap is published each time instead of only the part that changed."),
    listing("plugins", PLUGINS, PLUGINS,
        "Layers of the costmap. Only an obstacle layer followed by an inflation layer is supported."),
    real("circumscribed_radius", 0.46, 0.0, INF, None, "m",
        "Four times the local costmap's value is the side of the square outside of which the aggressive reset clears "
        "the costmaps."),
    real("obstacle_range", 2.5, 0.0, INF, 2.5, "m",
        "Without effect; exists for Clearpath's parameter files. The value of the scan source is used."),
    real("raytrace_range", 3.0, 0.0, INF, 3.0, "m",
        "Without effect; exists for Clearpath's parameter files. The value of the scan source is used."),
    flag("static_map", False, False, "Without effect beside plugins; exists for Clearpath's parameter files."),
    text("map_type", "costmap", "costmap", "Without effect; exists for Clearpath's parameter files."),
    flag("meter_scoring", False, True,
        "Without effect; exists for Clearpath's parameter files. The value of the local planner is used."),
    real("origin_z", 0.0, -INF, INF, 0.0, "m", "Without effect; exists for Clearpath's parameter files."),
    flag("publish_voxel_map", False, False, "Without effect; exists for Clearpath's parameter files."),
    real("z_resolution", 1, 0.0, INF, 1, "m", "Without effect; exists for Clearpath's parameter files."),
    whole("z_voxels", 2, 0, INT_MAX, 2, "", "Without effect; exists for Clearpath's parameter files."),
)

STATIC_OBSTACLES = (
    text("observation_sources", "scan", "scan",
        "Name of the single sensor source, a laser scan. Its parameters stand below this name."),
    real("obstacle_range", 2.5, 0.0, INF, 2.5, "m", "Without effect; the value of the scan source is used."),
    real("raytrace_range", 3.0, 0.0, INF, 3.0, "m", "Without effect; the value of the scan source is used."),
    flag("track_unknown_space", False, None, "Without effect; the value of the costmap is used."),
)

STATIC_SOURCE = (
    text("topic", "scan", "front/scan", "Topic of the laser scan."),
    text("data_type", "LaserScan", "LaserScan", "Message type of the source. Only LaserScan is supported."),
    text("sensor_frame", "", "front_laser", "Without effect; the frame in the scan's header is used."),
    flag("marking", True, True, "Whether the end points of beams mark obstacles."),
    flag("clearing", True, True, "Whether beams clear the cells that they pass."),
    flag("inf_is_valid", False, None,
        "Whether a beam without return (infinite range) clears cells up to the sensor's maximum range."),
    real("min_obstacle_height", -2.0, -INF, INF, -2.0, "m", "Height below which points are dropped."),
    real("max_obstacle_height", 2.0, -INF, INF, 2.0, "m", "Height above which points are dropped."),
    real("obstacle_range", 2.5, 0.0, INF, 2.5, "m",
        "Distance from the sensor beyond which obstacles are not marked."),
    real("raytrace_range", 3.0, 0.0, INF, 3.0, "m", "Distance from the sensor up to which beams clear cells."),
    real("observation_persistence", 0.0, 0.0, 0.0, None, "s",
        "How long scans are kept. Only 0 is supported: the newest scan alone is used."),
    real("expected_update_rate", 0.0, 0.0, INF, None, "s",
        "Without effect; scan_timeout decides when a missing scan stops the robot."),
)
