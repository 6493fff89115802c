"""Table of the parameters that searches and policies set, and a robot's default space.

folder.py calls `default_space` if robot.yaml has no parameter_space. policy/dimensionless.py takes
the outputs of a policy from OUTPUTS. The kind of each parameter is part of its declaration in
planner/parameters.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Dict, List, NamedTuple, Optional, Tuple

from applr_ros1.planner.parameters.costmap_parameters import INFLATION
from applr_ros1.planner.parameters.declarations import SERVERS, namespace
from applr_ros1.planner.parameters.layers import COSTMAPS, INFLATION_LAYER, arranged, layers
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError, by_name
from applr_ros1.planner.parameters.trees import Tree, branch
from applr_ros1.robots.robot import Base, Body, SpaceParameter, Target, number_at

# Servers, and kinds of servers, that own learnable parameters
TRAJECTORY = "TrajectoryPlannerROS"
DWA = "DWAPlannerROS"
MOVE_BASE = ""
BOTH_COSTMAPS = "costmaps"
LAYERS = "inflation layers"
DECLARED = {**SERVERS, LAYERS: INFLATION, BOTH_COSTMAPS: SERVERS[COSTMAPS[0]]}


class Learned(NamedTuple):
    """A learnable parameter.

    Attributes:
        place: Owner of the parameter: local planner, inflation layers, costmaps or move_base.
        low, high: Range in a robot's space, relative to the limit of the base for a speed or yaw
            rate, and to the width of the robot for a length.
        policy: Number of the policy output in the dimensionless encoding; 0 if only searches set
            the parameter.
        log: Whether the policy output is logarithmic.
        output_range: Range of the policy output in units of the encoding, if it differs from low
            and high. It is the same for both local planners, whose values a policy must reach.
        also: Second parameter of the same owner, which gets the same value; a leading "-" negates
            it.
        start: Initial value in move_base if the files omit the parameter. It may lie outside the
            range.
    """

    place: str
    name: str
    low: float
    high: float
    policy: int = 0
    log: bool = False
    output_range: Optional[Tuple[float, float]] = None
    also: str = ""
    start: Optional[float] = None

    @property
    def declared(self) -> Parameter:
        """Declaration of the parameter in the planner's tables."""
        return by_name(DECLARED[self.place])[self.name]


LEARNED = (  # rows in the order of the parameters in a space
    Learned(TRAJECTORY, "max_vel_x", 0.1, 1.0, 1),
    Learned(DWA, "max_vel_x", 0.1, 1.0, 1, also="max_vel_trans"),
    Learned(TRAJECTORY, "max_vel_theta", 0.1, 1.0, 2, also="-min_vel_theta"),
    Learned(DWA, "max_vel_theta", 0.1, 1.0, 2),
    Learned(TRAJECTORY, "vx_samples", 4.0, 20.0, 3, start=3.0),
    Learned(DWA, "vx_samples", 4.0, 20.0, 3, start=3.0),
    Learned(TRAJECTORY, "vtheta_samples", 4.0, 60.0, 4),
    Learned(DWA, "vth_samples", 4.0, 60.0, 4),
    Learned(TRAJECTORY, "sim_time", 0.8, 3.0, 5),
    Learned(DWA, "sim_time", 0.8, 3.0, 5),
    Learned(TRAJECTORY, "occdist_scale", 0.005, 1.0, 6, True),
    Learned(DWA, "occdist_scale", 0.005, 1.0, 6, True),
    Learned(TRAJECTORY, "path_distance_bias", 0.05, 3.0, 7, True, (0.4, 25.0)),
    Learned(DWA, "path_distance_bias", 0.5, 64.0, 7, True, (0.4, 25.0)),
    Learned(TRAJECTORY, "goal_distance_bias", 0.05, 3.0, 8, True, (0.4, 25.0)),
    Learned(DWA, "goal_distance_bias", 0.5, 64.0, 8, True, (0.4, 25.0)),
    Learned(DWA, "forward_point_distance", 0.0, 1.0, 12, start=0.325),
    Learned(DWA, "min_vel_x", 0.0, 0.0, 11, output_range=(-1.0, 0.0)),
    Learned(LAYERS, "inflation_radius", 0.15, 3.0, 9, True, (0.18, 3.0), start=0.55),
    Learned(LAYERS, "cost_scaling_factor", 1.0, 20.0, 10, True, (0.5, 12.0)),
    Learned(TRAJECTORY, "min_in_place_vel_theta", 0.05, 0.5, start=0.4),
    Learned(TRAJECTORY, "escape_reset_dist", 0.25, 2.0, start=0.1),
    Learned(TRAJECTORY, "escape_reset_theta", 0.1, 3.14, start=1.57),
    Learned(BOTH_COSTMAPS, "footprint_padding", 0.0, 0.45, start=0.01),
    Learned(MOVE_BASE, "planner_frequency", 0.0, 5.0, start=0.0),
)
# Rows of LEARNED for the policy outputs of the dimensionless encoding, in order. The key of an
# output is the name of the first parameter that it sets. NAMES maps the name of each parameter that
# an output sets to the output's key.
OUTPUTS: Dict[str, Learned] = {}
NAMES: Dict[str, str] = {}
_keys: Dict[int, str] = {}  # keys of the outputs by their numbers
for _row in sorted((row for row in LEARNED if row.policy), key=lambda row: row.policy):
    _key = _keys.setdefault(_row.policy, _row.name)
    OUTPUTS.setdefault(_key, _row)
    NAMES.update(dict.fromkeys(_row.declared.names, _key))


def default_space(base: Base, body: Body, tree: Tree) -> Tuple[SpaceParameter, ...]:
    """Return eleven to fifteen parameters of planners and costmaps.

    Their ranges include the initial values.

    The parameters are not validated, because check.py checks the tree later.

    Args:
        base: Base of the robot, whose limits bound the speeds.
        body: Body of the robot, whose width scales the lengths.
        tree: move_base parameters of the robot.
    """
    inflation_layers = []
    with suppress(ParameterError):  # The check reports this error.
        tree = arranged(tree)
        # A parameter is read back from its first server: the local costmap's.
        for costmap in COSTMAPS[::-1]:
            for layer in layers(costmap, branch(tree, costmap), INFLATION_LAYER):
                inflation_layers.append(layer.path)
    planner = namespace(str(tree.get("base_local_planner", TRAJECTORY)))
    servers = {
        LAYERS: inflation_layers,
        BOTH_COSTMAPS: list(COSTMAPS[::-1]),
        MOVE_BASE: [MOVE_BASE],
        DWA if planner == DWA else TRAJECTORY: [planner],
    }
    left_out = {
        # A policy must not reverse a robot whose default parameters never reverse it.
        "min_vel_x": (number_at(tree, planner, ("min_vel_x",)) or 0.0) >= 0.0,
        # The robot's owner has chosen a frequency.
        "planner_frequency": bool(number_at(tree, MOVE_BASE, ("planner_frequency",))),
    }
    units = {
        "speed": base.max_speed,
        "turn": base.max_yaw_rate,
        "length": max(body.size[1], base.track),
    }
    parameters = []
    for row in LEARNED:
        if servers.get(row.place) and not left_out.get(row.name):
            parameters.append(_space_parameter(row, servers[row.place], units, tree))
    return tuple(parameters)


def _space_parameter(
    row: Learned, servers: List[str], units: Dict[str, float], tree: Tree
) -> SpaceParameter:
    """Return a learnable parameter of some servers.

    Its range includes the initial value in `tree`.
    """
    declared = row.declared
    targets = []
    for server in servers:
        targets.append(
            Target.model_construct(server=server, name=row.name, aliases=declared.aliases)
        )
    if row.also:
        second_name = row.also.lstrip("-")
        negated = row.also.startswith("-")
        targets.append(Target.model_construct(server=servers[0], name=second_name, negated=negated))
    unit = units.get(declared.kind, 1.0)
    lowest = unit * row.low
    highest = unit * row.high
    start_value = number_at(tree, servers[0], targets[0].names)
    if start_value is None:
        start_value = row.start
    if start_value is not None:
        # move_base clamps its initial value, too.
        start_value = min(max(start_value, declared.min), declared.max)
        lowest = min(lowest, start_value)
        highest = max(highest, start_value)
    return SpaceParameter.model_construct(
        name=row.name,
        range=(lowest, highest),
        integer=declared.kind == "count",
        sets=tuple(targets),
        paper=row.policy > 0,
    )
