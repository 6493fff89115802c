"""Parameters of a costmap, of its layers, and of the sources of an obstacle layer.

Combined in declarations.py. Uses only the standard library because the .cfg files import it at
build time.
"""

from __future__ import annotations

from typing import Iterator

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.parameter import (
    INF,
    INT_MAX,
    OUTLINE,
    flag,
    listing,
    real,
    text,
    whole,
)
from applr_ros1.planner.parameters.trees import Tree

MAX_CELLS = 16_000_000  # largest number of cells of a costmap, 200 x 200 m at 0.05 m

# Columns: name, default, minimum, maximum, unit, description; for flags, texts and lists only name,
# default, description
# fmt: off
COMBINATION = (
    ("Overwrite", 0, "Known cells of this layer replace those of the costmap."),
    ("Maximum", 1, "The larger value of layer and costmap is kept."),
)

# Parameters that dynamic_reconfigure can change: the costmap, its inflation, obstacle and static
# layers
COSTMAP = (
    real("transform_tolerance", 0.3, 0.0, 10.0, "s",
        "Largest age of a robot pose that is still used."),
    real("update_frequency", 5.0, 0.0, 100.0, "Hz",
        "Rate at which the costmap is updated with the latest scan. 0 disables updates."),
    real("publish_frequency", 0.0, 0.0, 100.0, "Hz",
        "Highest rate at which the costmap is published. 0 disables publishing."),
    whole("width", 10, 0, INT_MAX, "m", "Size of the costmap along x.", not_zero=True),
    whole("height", 10, 0, INT_MAX, "m", "Size of the costmap along y.", not_zero=True),
    real("resolution", 0.05, 0.0, 50.0, "m", "Edge length of a cell, at most width and height.",
        not_zero=True),
    real("origin_x", 0.0, -INF, INF, "m", "x coordinate of the lower corner of the costmap."),
    real("origin_y", 0.0, -INF, INF, "m", "y coordinate of the lower corner of the costmap."),
    text("footprint", "[]",
        "Outline of the robot as a list of points [[x, y], ...] in metres. If it is [], a circle "
        "of robot_radius is used.", once=(OUTLINE,)),
    real("robot_radius", 0.46, 0.0, 10.0, "m",
        "Radius of a round robot, used if no footprint is given.", once=(OUTLINE,)),
    real("footprint_padding", 0.01, -INF, INF, "m",
        "Distance by which the footprint is enlarged on every side.",
        kind="length", once=(OUTLINE,)),
)

INFLATION = (
    flag("enabled", True, "Whether costs are spread around obstacles."),
    real("cost_scaling_factor", 10.0, 0.0, 100.0, "1/m",
        "Rate at which the cost decays with the distance from an obstacle. Larger values give a "
        "steeper decay.", kind="1/length"),
    real("inflation_radius", 0.55, 0.0, 50.0, "m",
        "Distance from an obstacle up to which cells have a cost.", kind="length"),
    flag("inflate_unknown", False, "Whether unknown cells take inflated costs."),
)

OBSTACLES = (
    flag("enabled", True, "Whether the laser scan marks and clears cells."),
    flag("footprint_clearing_enabled", True,
        "Whether cells under the footprint of the robot are always free."),
    real("max_obstacle_height", 2.0, 0.0, 50.0, "m",
        "Height above which points do not mark obstacles."),
    whole("combination_method", 1, -INT_MAX - 1, INT_MAX, "",
        "How this layer is combined with the costmap.", enum=COMBINATION),
)

STATIC_MAP = (
    flag("enabled", True, "Whether the map is written into the costmap."),
)

# Read once, when the node starts: the costmap, its layers, the sources of an obstacle layer
STATIC_COSTMAP = (
    text("global_frame", "map",
        "Frame of the costmap. The two costmaps may have different frames, such as map and odom. "
        "Goals are transformed into the frame of the global costmap."),
    text("robot_base_frame", "base_link", "Frame of the robot base."),
    flag("rolling_window", False, "Whether the costmap moves along with the robot."),
    flag("track_unknown_space", False,
        "Whether cells are unknown instead of free until a layer observes them. If it is given, it "
        "also applies to the static and obstacle layers of the costmap."),
    flag("always_send_full_costmap", False,
        "Whether the whole costmap is published each time instead of only the part that changed."),
    listing("plugins", [],
        "Names and types of the layers, from the lowest to the highest: costmap_2d::StaticLayer, "
        "costmap_2d::ObstacleLayer and costmap_2d::InflationLayer in any number and order. Without "
        "it the layers are static_layer (with static_map), obstacle_layer and inflation_layer, and "
        "their parameters are read from the costmap itself."),
    real("circumscribed_radius", 0.46, 0.0, INF, "m",
        "A quarter of the side of the square outside of which the aggressive reset clears the "
        "costmaps. Only the value of the local costmap is used."),
    real("obstacle_range", 2.5, 0.0, INF, "m",
        "If it is given here, it applies to all obstacle layers of the costmap."),
    real("raytrace_range", 3.0, 0.0, INF, "m",
        "If it is given here, it applies to all obstacle layers of the costmap."),
    flag("static_map", False,
        "Whether a file without plugins has a static layer. No effect if plugins is given."),
    text("map_type", "costmap",
        "If it is voxel and plugins is not given, an obstacle layer replaces the voxel layer. No "
        "effect otherwise."),
    flag("meter_scoring", False,
        "No effect; accepted for Clearpath's parameter files. The value of the local planner is "
        "used."),
    real("origin_z", 0.0, -INF, INF, "m", "No effect; accepted for Clearpath's parameter files."),
    flag("publish_voxel_map", False, "No effect; accepted for Clearpath's parameter files."),
    real("z_resolution", 1, -INF, INF, "m", "No effect; accepted for Clearpath's parameter files."),
    whole("z_voxels", 2, -INT_MAX - 1, INT_MAX, "",
        "No effect; accepted for Clearpath's parameter files."),
)

STATIC_OBSTACLES = (
    text("observation_sources", "",
        "Names of the sensor sources of the layer, separated by spaces. Each name is the name "
        "space of its source."),
    real("obstacle_range", 2.5, 0.0, INF, "m",
        "Distance from the sensor beyond which points are not marked, for sources without a value "
        "of their own."),
    real("raytrace_range", 3.0, 0.0, INF, "m",
        "Distance from the sensor up to which rays clear cells, for sources without a value of "
        "their own."),
    flag("track_unknown_space", False,
        "Whether cells of the layer are unknown until they are observed. Defaults to the value of "
        "the costmap."),
)

STATIC_SOURCE = (
    text("topic", "", "Topic of the source. Defaults to the name of the source."),
    text("data_type", "PointCloud",
        "Message type of the source: LaserScan, PointCloud2 or PointCloud."),
    text("sensor_frame", "",
        "Frame at whose origin the rays start. If it is empty or unknown to tf, the frame of the "
        "messages is used."),
    flag("marking", True, "Whether the points mark obstacles."),
    flag("clearing", False, "Whether the rays clear the cells that they pass."),
    flag("inf_is_valid", False,
        "Whether a beam of a LaserScan without return (infinite range) clears cells up to "
        "raytrace_range."),
    real("min_obstacle_height", 0.0, -INF, INF, "m",
        "Height in the costmap's frame below which points are dropped."),
    real("max_obstacle_height", 2.0, -INF, INF, "m",
        "Height in the costmap's frame above which points are dropped."),
    real("obstacle_range", 2.5, 0.0, INF, "m",
        "Distance from the sensor beyond which points are not marked.", beyond="error"),
    real("raytrace_range", 3.0, 0.0, INF, "m",
        "Distance from the sensor up to which rays clear cells."),
    real("observation_persistence", 0.0, 0.0, INF, "s",
        "Time for which messages are kept and applied in each update. If it is 0, only the latest "
        "message is used.", beyond="error"),
    real("expected_update_rate", 0.0, 0.0, INF, "s",
        "Time without a message after which the robot stops, for sources of the local costmap. If "
        "it is 0, only scan_timeout is checked.", beyond="error"),
)

STATIC_STATIC_MAP = (
    text("map_topic", "map", "Latched topic of the map, as published by map_server."),
    flag("first_map_only", False, "Whether maps after the first one are ignored."),
    flag("subscribe_to_updates", False,
        "Whether changes of the map are received, on the topic of the map with the suffix "
        "_updates."),
    flag("track_unknown_space", True,
        "Whether unknown cells of the map are unknown in the costmap instead of free."),
    flag("use_maximum", False,
        "Whether the map only raises the costs of the layers below instead of replacing all of "
        "them."),
    whole("lethal_cost_threshold", 100, -INT_MAX - 1, INT_MAX, "",
        "Lowest occupancy of a lethal cell, clamped to 0 to 100."),
    whole("unknown_cost_value", -1, -INT_MAX - 1, INT_MAX, "", "Occupancy of an unknown cell."),
    flag("trinary_costmap", True,
        "Whether cells of lower occupancy are free. Otherwise their cost is proportional to their "
        "occupancy."),
)
# fmt: on
DATA_TYPES = ("LaserScan", "PointCloud2", "PointCloud")


def contradictions(values: Tree) -> Iterator[str]:
    """Yield a message for an impossible size, and for an invalid footprint."""
    from applr_ros1.planner.costmap import footprint  # needs numpy

    width = values["width"]
    height = values["height"]
    resolution = values["resolution"]
    columns = width / resolution
    rows = height / resolution
    size = f"width, height are {width} x {height} m at a resolution of {resolution:g} m"
    if not (columns >= 1 and rows >= 1):
        yield f"{size}, which gives no cells: give at least one cell along each axis"
    elif columns * rows > MAX_CELLS:
        yield f"{size}, which gives {columns * rows:.3g} cells: give at most {MAX_CELLS:g}"

    # A coordinate of 100 m or more is one in centimetres or millimetres.
    outline = values["footprint"]
    try:
        is_outline = bool((abs(footprint.parse(outline)) < 100.0).all())
    except ApplrError:
        is_outline = False
    if not is_outline:
        yield f"footprint is {outline:.60}: give at least three points, [[x, y], ...] in metres"
