"""Parameters of move_base itself, its recovery behaviours, navfn, and of the applr node.

Combined in declarations.py. Uses only the standard library because the .cfg files import it at
build time.
"""

from __future__ import annotations

from applr_ros1.planner.parameters.parameter import (
    INF,
    INT_MAX,
    PERIOD,
    RECOVERY,
    RESTORE,
    flag,
    listing,
    real,
    text,
    whole,
)

# Columns: name, default, minimum, maximum, unit, description; for flags, texts and lists only name,
# default, description
# fmt: off
CLEAR_TYPE = "clear_costmap_recovery/ClearCostmapRecovery"
ROTATE_TYPE = "rotate_recovery/RotateRecovery"
RECOVERY_TYPES = (CLEAR_TYPE, ROTATE_TYPE)
DEFAULT_RECOVERIES = [
    {"name": "conservative_reset", "type": CLEAR_TYPE},
    {"name": "rotate_recovery", "type": ROTATE_TYPE},
    {"name": "aggressive_reset", "type": CLEAR_TYPE},
    {"name": "rotate_recovery", "type": ROTATE_TYPE},
]

# Parameters that dynamic_reconfigure can change
MOVE_BASE = (
    text("base_global_planner", "navfn/NavfnROS",
        "Plugin name of the global planner. Only navfn is available."),
    text("base_local_planner", "base_local_planner/TrajectoryPlannerROS",
        "Plugin name of the local planner: base_local_planner/TrajectoryPlannerROS or "
        "dwa_local_planner/DWAPlannerROS. Read once, when the node starts."),
    real("planner_frequency", 0.0, 0.0, 100.0, "Hz",
        "Rate at which the global plan is renewed while the robot drives. If it is 0, a plan is "
        "made for each new goal and after each failure to find a velocity."),
    real("controller_frequency", 20.0, 0.0, 100.0, "Hz",
        "Rate at which velocity commands are chosen and published. It must be above 0.",
        not_zero=True, once=(PERIOD,)),
    real("planner_patience", 5.0, 0.0, 100.0, "s",
        "Time without a global plan after which a recovery behaviour starts."),
    real("controller_patience", 5.0, 0.0, 100.0, "s",
        "Time without a valid velocity command after which a recovery behaviour starts."),
    whole("max_planning_retries", -1, -1, 1000, "",
        "Number of failed planning attempts after which a recovery behaviour starts. -1 sets no "
        "limit."),
    real("conservative_reset_dist", 3.0, 0.0, 50.0, "m",
        "Side of the square around the robot outside of which the conservative reset clears the "
        "costmaps.", once=(RECOVERY,)),
    flag("recovery_behavior_enabled", True,
        "Whether recovery behaviours are tried before a goal is aborted."),
    flag("clearing_rotation_allowed", True,
        "Whether the recovery behaviours may rotate the robot in place.", once=(RECOVERY,)),
    flag("shutdown_costmaps", False, "Whether the costmaps stop updating while there is no goal."),
    real("oscillation_timeout", 0.0, 0.0, 60.0, "s",
        "Time within which the robot has to move by oscillation_distance; otherwise a recovery "
        "behaviour starts. 0 disables this check."),
    real("oscillation_distance", 0.5, 0.0, 10.0, "m",
        "Distance that the robot has to move to count as not oscillating."),
    flag("make_plan_clear_costmap", True,
        "Whether the make_plan service first clears a square around the robot in both costmaps."),
    flag("make_plan_add_unreachable_goal", True,
        "Whether the make_plan service appends the requested goal to a plan that only reaches a "
        "point near it."),
    RESTORE,
)

# Read once, when the node starts
STATIC_MOVE_BASE = (
    listing("recovery_behaviors", DEFAULT_RECOVERIES,
        "Names and types of the recovery behaviours in the order in which they are tried. An empty "
        "list disables recovery. clearing_rotation_allowed removes rotations from the default list "
        "only."),
    real("scan_timeout", 1.0, 0.0, INF, "s",
        "Age of the latest scan at which the robot is stopped. 0 disables this check.",
        beyond="error"),
    flag("latch_xy_goal_tolerance", False,
        "For DWAPlannerROS: whether the goal position, once reached, remains reached until the "
        "next plan."),
    real("clearing_radius", 0.46, 0.0, INF, "m",
        "Half the side of the square that make_plan_clear_costmap clears."),
)

# Parameters of recovery behaviours that clear the costmaps (besides reset_distance), and of
# rotations
CLEARING = (
    listing("layer_names", ["obstacles"],
        "No effect; accepted for parameter files of the C++ node. All obstacle layers are cleared, "
        "whatever their names."),
    text("affected_maps", "both",
        "No effect; accepted for parameter files of the C++ node. Both costmaps are cleared."),
    flag("force_updating", False, "No effect; accepted for parameter files of the C++ node."),
    flag("invert_area_to_clear", False,
        "No effect; accepted for parameter files of the C++ node. The outside of the square is "
        "cleared."),
)
ROTATE_RECOVERY = (
    real("sim_granularity", 0.017, 0.0, INF, "rad",
        "Rotation between two poses that are checked for collision during the turn.",
        not_zero=True),
    real("frequency", 20.0, 0.0, INF, "Hz",
        "No effect; accepted for parameter files of the C++ node. A turn is commanded at "
        "controller_frequency."),
)

# Parameters of each behaviour in a recovery_behaviors list
BEHAVIOUR = (
    real("reset_distance", 3.0, 0.0, INF, "m",
        "Side of the square around the robot outside of which this behaviour clears the costmaps."),
) + CLEARING + ROTATE_RECOVERY

CONSERVATIVE_RESET = (
    real("reset_distance", 3.0, 0.0, INF, "m",
        "Side of the square that the conservative reset keeps. Set from conservative_reset_dist."),
) + CLEARING

AGGRESSIVE_RESET = (
    real("reset_distance", 1.84, 0.0, INF, "m",
        "Side of the square that the aggressive reset keeps: 4 times "
        "local_costmap/circumscribed_radius."),
) + CLEARING

STATIC_NAVFN = (
    flag("allow_unknown", True, "Whether plans may lead through unknown cells."),
    real("default_tolerance", 0.0, 0.0, INF, "m",
        "Distance from the goal within which a plan may end if the goal itself cannot be reached."),
    flag("visualize_potential", False, "No effect: the potential is not published."),
)

APPLR_NODE = (
    real("period", 2.0, 0.0, INF, "s",
        "Longest time between two heartbeats of the applr node, which sends one in each decision "
        "period and at least every 2 s. If none arrives for 2.5 times this period, the start-up "
        "parameters are restored.", beyond="error"),
    real("max_speed", 0.0, 0.0, INF, "m/s",
        "Largest speed of a command, forwards and backwards. A faster command is slowed down along "
        "its arc, whoever set the parameters. 0 sets no limit. The applr node has a max_speed of "
        "its own, below which it chooses.", beyond="error"),
    flag("movers", False,
        "Whether both costmaps mark the predicted positions of moving obstacles from "
        "applr/predicted, as an additional source of each layer that has a laser."),
    whole("recovery_rounds", 0, 0, INT_MAX, "",
        "Number of times that the recovery behaviours may start anew for one goal without bringing "
        "the robot 0.5 m nearer to it, before the goal is aborted. 0 sets no limit, as in C++, "
        "where a robot may circle an unreachable goal forever.", beyond="error"),
)
