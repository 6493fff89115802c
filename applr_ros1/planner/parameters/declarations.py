"""Every parameter of move_base, once: name, type, bounds, default, the Jackal's value, unit and a sentence.

The cfg files, the README's table, the parameter check at start-up and MoveBase itself follow from it.
Pure standard library: the .cfg files import it at build time under an interpreter without numpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Dict, List, Tuple

INF = math.inf
INT_MAX = 2147483647
MAX_CELLS = 16_000_000  # of one costmap; a larger map is refused instead of filling the memory


@dataclass(frozen=True)
class Parameter:
    """One parameter. `jackal` is None where the Jackal's files leave the default."""

    name: str
    type: str  # "double", "int", "bool", "str"; static ones also "list"
    default: Any
    min: Any
    max: Any
    jackal: Any
    unit: str
    doc: str
    aliases: Tuple[str, ...] = ()  # older names that always show the same value
    enum: Tuple[Tuple[str, int, str], ...] = ()  # (name, value, sentence)
    not_zero: bool = False  # 0 lies within the bounds but cannot work: refused

    @property
    def value(self):
        """What the Jackal runs with."""
        return self.default if self.jackal is None else self.jackal


class ParameterError(ValueError):
    """A name or value that cannot be taken; the message is one line with the remedy."""


def _double(name, default, low, high, jackal, unit, doc, **more):
    return Parameter(name, "double", default, low, high, jackal, unit, doc, **more)


def _int(name, default, low, high, jackal, unit, doc, **more):
    return Parameter(name, "int", default, low, high, jackal, unit, doc, **more)


def _bool(name, default, jackal, doc):
    return Parameter(name, "bool", default, False, True, jackal, "", doc)


def _str(name, default, jackal, doc):
    return Parameter(name, "str", default, "", "", jackal, "", doc)


def _list(name, default, jackal, doc):
    return Parameter(name, "list", default, None, None, jackal, "", doc)


_RESTORE = _bool("restore_defaults", False, False, "Puts all of this server back to its start-up values.")

_MOVE_BASE = (
    _str("base_global_planner", "navfn/NavfnROS", "navfn/NavfnROS", "Global planner; only navfn is built in."),
    _str(
        "base_local_planner",
        "base_local_planner/TrajectoryPlannerROS",
        "base_local_planner/TrajectoryPlannerROS",
        "Local planner; only this one is built in.",
    ),
    _double(
        "planner_frequency",
        0.0,
        0.0,
        100.0,
        20.0,
        "Hz",
        "How often the plan is made anew while driving; 0 plans once per goal or loss of control.",
    ),
    _double(
        "controller_frequency",
        20.0,
        0.0,
        100.0,
        20.0,
        "Hz",
        "How often a velocity command is chosen; 0 is refused.",
        not_zero=True,
    ),
    _double("planner_patience", 5.0, 0.0, 100.0, 5.0, "s", "Time without a plan after which a recovery begins."),
    _double(
        "controller_patience", 5.0, 0.0, 100.0, 15.0, "s", "Time without a valid command after which a recovery begins."
    ),
    _int("max_planning_retries", -1, -1, 1000, -1, "", "Failed plans before a recovery begins; -1 sets no limit."),
    _double(
        "conservative_reset_dist",
        3.0,
        0.0,
        50.0,
        3.0,
        "m",
        "Side of the square that the first map clearing keeps; read when the node starts.",
    ),
    _bool("recovery_behavior_enabled", True, True, "Whether recoveries are tried before a goal is aborted."),
    _bool(
        "clearing_rotation_allowed",
        True,
        True,
        "Whether recoveries may turn the robot in place; read when the node starts.",
    ),
    _bool("shutdown_costmaps", False, False, "Whether the costmaps rest while there is no goal."),
    _double(
        "oscillation_timeout",
        0.0,
        0.0,
        60.0,
        0.0,
        "s",
        "Time without moving oscillation_distance after which a recovery begins; 0 switches this off.",
    ),
    _double("oscillation_distance", 0.5, 0.0, 10.0, 0.5, "m", "Movement that counts as getting on."),
    _bool("make_plan_clear_costmap", True, True, "Whether make_plan frees a square about the robot first."),
    _bool(
        "make_plan_add_unreachable_goal",
        True,
        True,
        "Whether make_plan appends the asked goal when it could only plan to a point near it.",
    ),
    _RESTORE,
)

_TRAJECTORY_PLANNER = (
    _double("acc_lim_x", 2.5, 0.0, 20.0, 10.0, "m/s^2", "Forward acceleration that the sampling assumes."),
    _double("acc_lim_y", 2.5, 0.0, 20.0, 2.5, "m/s^2", "Sideways acceleration; the base cannot strafe."),
    _double("acc_lim_theta", 3.2, 0.0, 20.0, 20.0, "rad/s^2", "Angular acceleration that the sampling assumes."),
    _double("max_vel_x", 0.55, 0.0, 20.0, 0.5, "m/s", "Largest forward speed that is sampled."),
    _double("min_vel_x", 0.0, 0.0, 20.0, 0.1, "m/s", "Smallest forward speed that is sampled."),
    _double("max_vel_theta", 1.0, 0.0, 20.0, 1.57, "rad/s", "Largest turn rate to the left that is sampled."),
    _double("min_vel_theta", -1.0, -20.0, 0.0, -1.57, "rad/s", "Largest turn rate to the right, a negative number."),
    _double("min_in_place_vel_theta", 0.4, 0.0, 20.0, 0.314, "rad/s", "Slowest turn in place."),
    _double("sim_time", 1.7, 0.0, 10.0, 2.0, "s", "How far ahead a sampled velocity is simulated.", not_zero=True),
    _double("sim_granularity", 0.025, 0.0, 5.0, 0.02, "m", "Distance between simulated points.", not_zero=True),
    _double(
        "angular_sim_granularity", 0.025, 0.0, math.pi / 2, 0.02, "rad", "Turn between simulated points.", not_zero=True
    ),
    _double(
        "path_distance_bias", 0.6, 0.0, 5.0, 0.75, "", "Weight of the distance to the plan.", aliases=("pdist_scale",)
    ),
    _double(
        "goal_distance_bias",
        0.8,
        0.0,
        5.0,
        1.0,
        "",
        "Weight of the distance to the local goal.",
        aliases=("gdist_scale",),
    ),
    _double("occdist_scale", 0.01, 0.0, 5.0, 0.1, "", "Weight of the largest cost met on the way."),
    _double(
        "oscillation_reset_dist",
        0.05,
        0.0,
        5.0,
        0.05,
        "m",
        "Movement after which a barred turning direction is free again.",
    ),
    _double("escape_reset_dist", 0.1, 0.0, 5.0, 0.1, "m", "Movement that ends backing out."),
    _double("escape_reset_theta", math.pi / 2, 0.0, 5.0, 0.1, "rad", "Turn that ends backing out."),
    _int("vx_samples", 20, 1, 300, 6, "", "Number of forward speeds sampled."),
    _int("vtheta_samples", 20, 1, 300, 20, "", "Number of turn rates sampled."),
    _double(
        "heading_lookahead",
        0.325,
        0.0,
        5.0,
        0.325,
        "m",
        "How far ahead of the final heading a turn in place is judged.",
    ),
    _bool("holonomic_robot", True, False, "Kept for clients; a differential base is always assumed."),
    _double("escape_vel", -0.1, -2.0, 2.0, -0.5, "m/s", "Velocity of backing out; negative is backwards."),
    _bool("dwa", False, True, "Sample what is reachable within one control period instead of sim_time."),
    _bool("heading_scoring", False, False, "Score by the heading towards the plan instead of the distance to it."),
    _double("heading_scoring_timestep", 0.1, 0.0, 1.0, 0.8, "s", "When on the way heading_scoring looks."),
    _bool("simple_attractor", False, False, "Head for the plan's last point instead of following the plan."),
    _str("y_vels", "-0.3,-0.1,0.1,-0.3", "-0.3,-0.1,0.1,-0.3", "Kept for clients; sideways speeds of other bases."),
    _RESTORE,
)

_COSTMAP = (
    _double("transform_tolerance", 0.3, 0.0, 10.0, 0.5, "s", "Oldest robot pose that is still used."),
    _double("update_frequency", 5.0, 0.0, 100.0, 20.0, "Hz", "How often the map takes in the scan; 0 never does."),
    _double("publish_frequency", 0.0, 0.0, 100.0, 5.0, "Hz", "How often the map is published at most; 0 never does."),
    _int("width", 10, 0, INT_MAX, 10, "m", "Size of the map along x.", not_zero=True),
    _int("height", 10, 0, INT_MAX, 10, "m", "Size of the map along y.", not_zero=True),
    _double("resolution", 0.05, 0.0, 50.0, 0.05, "m", "Edge of a cell.", not_zero=True),
    _double("origin_x", 0.0, -INF, INF, 0.0, "m", "Where the map's low corner lies along x."),
    _double("origin_y", 0.0, -INF, INF, 0.0, "m", "Where the map's low corner lies along y."),
    _str(
        "footprint",
        "[]",
        "[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]",
        "The robot's outline as [[x, y], ...] in metres; [] takes a circle of robot_radius.",
    ),
    _double("robot_radius", 0.46, 0.0, 10.0, 0.46, "m", "Radius of a round robot, used without a footprint."),
    _double("footprint_padding", 0.01, -INF, INF, 0.1, "m", "Distance added to the outline on every side."),
)

_INFLATION = (
    _bool("enabled", True, True, "Whether obstacles are inflated."),
    _double("cost_scaling_factor", 10.0, 0.0, 100.0, 10.0, "1/m", "How fast the cost falls with distance."),
    _double("inflation_radius", 0.55, 0.0, 50.0, 0.3, "m", "How far cost reaches around an obstacle."),
    _bool("inflate_unknown", False, False, "Whether unknown cells take inflated cost."),
)

_COMBINATION = (
    ("Overwrite", 0, "Known cells of the layer replace those of the map."),
    ("Maximum", 1, "The larger of the two costs stays."),
)
_OBSTACLES = (
    _bool("enabled", True, True, "Whether the scan marks and clears cells."),
    _bool("footprint_clearing_enabled", True, True, "Whether cells under the robot are kept free."),
    _double("max_obstacle_height", 2.0, 0.0, 50.0, 2.0, "m", "Higher points do not count as obstacles."),
    _int("combination_method", 1, -INT_MAX - 1, INT_MAX, 1, "", "How the layer joins the map.", enum=_COMBINATION),
)


def _with(parameters: Tuple[Parameter, ...], **jackal) -> Tuple[Parameter, ...]:
    """The same parameters with other Jackal values."""
    return tuple(replace(p, jackal=jackal.get(p.name, p.jackal)) for p in parameters)


GLOBAL = dict(width=40, height=40, origin_x=-20.0, origin_y=-20.0)
SERVERS: Dict[str, Tuple[Parameter, ...]] = {
    "": _MOVE_BASE,
    "TrajectoryPlannerROS": _TRAJECTORY_PLANNER,
    "global_costmap": _with(_COSTMAP, **GLOBAL),
    "global_costmap/inflater_layer": _INFLATION,
    "global_costmap/obstacles_layer": _OBSTACLES,
    "local_costmap": _COSTMAP,
    "local_costmap/inflater_layer": _INFLATION,
    "local_costmap/obstacles_layer": _OBSTACLES,
}

PLUGINS = [
    {"name": "obstacles_layer", "type": "costmap_2d::ObstacleLayer"},
    {"name": "inflater_layer", "type": "costmap_2d::InflationLayer"},
]
_STATIC_COSTMAP = (
    _str("global_frame", "odom", "odom", "Frame of the map; both costmaps and the goal use the same."),
    _str("robot_base_frame", "base_link", "base_link", "Frame of the robot."),
    _bool("rolling_window", False, True, "Whether the map moves with the robot."),
    _bool("track_unknown_space", False, None, "Whether cells start as unknown instead of free."),
    _bool("always_send_full_costmap", False, None, "Whether every publication is the whole map."),
    _list("plugins", PLUGINS, PLUGINS, "The layers; always an obstacle layer, then an inflation layer."),
    _double(
        "circumscribed_radius",
        0.46,
        0.0,
        INF,
        None,
        "m",
        "Its fourfold (of the local costmap) is the side of the square that aggressive_reset keeps.",
    ),
    _double("obstacle_range", 2.5, 0.0, INF, 2.5, "m", "Kept for Clearpath's files; the scan's own counts."),
    _double("raytrace_range", 3.0, 0.0, INF, 3.0, "m", "Kept for Clearpath's files; the scan's own counts."),
    _bool("static_map", False, False, "Kept for Clearpath's files; without effect beside plugins."),
    _str("map_type", "costmap", "costmap", "Kept for Clearpath's files."),
    _bool("meter_scoring", False, True, "Kept for Clearpath's files; the local planner's own counts."),
    _double("origin_z", 0.0, -INF, INF, 0.0, "m", "Kept for Clearpath's files."),
    _bool("publish_voxel_map", False, False, "Kept for Clearpath's files."),
    _double("z_resolution", 1, 0.0, INF, 1, "m", "Kept for Clearpath's files."),
    _int("z_voxels", 2, 0, INT_MAX, 2, "", "Kept for Clearpath's files."),
)
_STATIC_OBSTACLES = (
    _str("observation_sources", "scan", "scan", "Name of the one source, a laser scan, described under that name."),
    _double("obstacle_range", 2.5, 0.0, INF, 2.5, "m", "Used where the source does not say."),
    _double("raytrace_range", 3.0, 0.0, INF, 3.0, "m", "Used where the source does not say."),
    _bool("track_unknown_space", False, None, "Kept for clients; the costmap's own counts."),
)
_STATIC_SOURCE = (
    _str("topic", "scan", "front/scan", "Topic of the scan."),
    _str("data_type", "LaserScan", "LaserScan", "Message type; only LaserScan is built in."),
    _str("sensor_frame", "", "front_laser", "Kept for Clearpath's files; the scan's own frame counts."),
    _bool("marking", True, True, "Whether hits mark obstacles."),
    _bool("clearing", True, True, "Whether beams clear what they pass."),
    _bool("inf_is_valid", False, None, "Whether a beam without return clears up to the sensor's range."),
    _double("min_obstacle_height", -2.0, -INF, INF, -2.0, "m", "Lower points are dropped."),
    _double("max_obstacle_height", 2.0, -INF, INF, 2.0, "m", "Higher points are dropped."),
    _double("obstacle_range", 2.5, 0.0, INF, 2.5, "m", "Hits farther away do not mark."),
    _double("raytrace_range", 3.0, 0.0, INF, 3.0, "m", "Beams clear this far at most."),
    _double("observation_persistence", 0.0, 0.0, 0.0, None, "s", "Only the newest scan is kept."),
    _double(
        "expected_update_rate",
        0.0,
        0.0,
        INF,
        None,
        "s",
        "Kept for clients; the node's own watch on the scan (scan_timeout) stops the robot.",
    ),
)
RECOVERY_TYPES = ("clear_costmap_recovery/ClearCostmapRecovery", "rotate_recovery/RotateRecovery")
DEFAULT_RECOVERIES = [
    {"name": name, "type": RECOVERY_TYPES[kind]}
    for name, kind in (
        ("conservative_reset", 0),
        ("rotate_recovery", 1),
        ("aggressive_reset", 0),
        ("rotate_recovery", 1),
    )
]
BEHAVIOUR = (  # of each behaviour that a recovery_behaviors list names
    _double("reset_distance", 3.0, 0.0, INF, None, "m", "Side of the square that this clearing keeps."),
    _double("sim_granularity", 0.017, 0.0, INF, None, "rad", "Turn between checked poses.", not_zero=True),
)
STATIC: Dict[str, Tuple[Parameter, ...]] = {
    "": (
        _list(
            "recovery_behaviors",
            [],
            None,
            "Names and types of the recoveries in order; empty takes the four usual ones.",
        ),
        _double("scan_timeout", 1.0, 0.0, INF, None, "s", "Age of the newest scan at which the robot stands still."),
        _double(
            "clearing_radius", 0.46, 0.0, INF, None, "m", "Half side of the square that make_plan_clear_costmap frees."
        ),
    ),
    "TrajectoryPlannerROS": (
        _double("xy_goal_tolerance", 0.1, 0.0, INF, 0.25, "m", "Distance at which the goal's place is reached."),
        _double("yaw_goal_tolerance", 0.05, 0.0, INF, 0.157, "rad", "Angle at which the goal's heading is reached."),
        _bool("latch_xy_goal_tolerance", False, False, "Whether the place, once reached, stays reached."),
        _bool("prune_plan", True, None, "Whether the plan behind the robot is dropped."),
        _double("max_rotational_vel", 1.0, 0.0, INF, None, "rad/s", "Fastest turn to the goal's heading."),
        _bool("meter_scoring", False, True, "Whether the two distance weights count per metre instead of per cell."),
        _double("controller_frequency", 20.0, 0.0, INF, 20.0, "Hz", "Its inverse is the dynamic window's period."),
        _bool("publish_cost_grid_pc", False, True, "Whether cost_cloud is published for RViz."),
    ),
    "NavfnROS": (
        _bool("allow_unknown", True, None, "Whether plans may cross unknown cells."),
        _double("default_tolerance", 0.0, 0.0, INF, None, "m", "How far from the goal a plan may end."),
        _bool("visualize_potential", False, None, "Kept for clients; the potential is not published."),
    ),
    "conservative_reset": (_double("reset_distance", 3.0, 0.0, INF, 3.0, "m", "Set from conservative_reset_dist."),),
    "aggressive_reset": (
        _double("reset_distance", 1.84, 0.0, INF, 1.84, "m", "Set from local_costmap/circumscribed_radius."),
    ),
    "applr": (
        _double(
            "period",
            2.0,
            0.0,
            INF,
            None,
            "s",
            "Time between decisions of the applr node; theta_0 comes back within three if it dies.",
        ),
    ),
    "rotate_recovery": (
        _double("sim_granularity", 0.017, 0.0, INF, None, "rad", "Turn between checked poses.", not_zero=True),
    ),
    "global_costmap": _with(_STATIC_COSTMAP, rolling_window=False, static_map=True),
    "global_costmap/obstacles_layer": _STATIC_OBSTACLES,
    "global_costmap/obstacles_layer/scan": _STATIC_SOURCE,
    "local_costmap": _STATIC_COSTMAP,
    "local_costmap/obstacles_layer": _STATIC_OBSTACLES,
    "local_costmap/obstacles_layer/scan": _STATIC_SOURCE,
}


def _jackal_tree() -> Dict[str, Any]:
    tree: Dict[str, Any] = {}
    for table in (STATIC, SERVERS):
        for path, parameters in table.items():
            here = tree
            for part in filter(None, path.split("/")):
                here = here.setdefault(part, {})
            for p in parameters:
                if p.jackal is not None:
                    here.update({name: p.jackal for name in (p.name,) + p.aliases})
    return {name: value for name, value in tree.items() if value != {}}


JACKAL: Dict[str, Any] = _jackal_tree()


def check(tree: Dict[str, Any]) -> List[str]:
    """What is wrong with a nested parameter tree, one line each; see parameter_check.py."""
    from applr_ros1.planner.parameters import check as parameter_check

    return parameter_check.check(tree)
