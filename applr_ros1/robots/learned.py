"""The parameters that searches and policies set, each in one line, and the parameter space of a robot made of them.

folder.py calls `default_space` where robot.yaml states no space; policy/dimensionless.py takes the outputs of a policy
from OUTPUTS. What kind of value a parameter is stands with its declaration in planner/parameters.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import INFLATION
from applr_ros1.planner.parameters.declarations import SERVERS, namespace
from applr_ros1.planner.parameters.layers import COSTMAPS, INFLATION_LAYER, arranged, layers
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError
from applr_ros1.robots.robot import Base, Body, Setting, SpaceParameter, number_at

TRAJECTORY, DWA, MOVE_BASE = "TrajectoryPlannerROS", "DWAPlannerROS", ""
BOTH_COSTMAPS, LAYERS = "costmaps", "inflation layers"
DECLARED = {**SERVERS, LAYERS: INFLATION, BOTH_COSTMAPS: SERVERS[COSTMAPS[0]]}


class Learned(NamedTuple):
    """A parameter that is learnt.

    Attributes:
        place: Local planner, layers, costmaps or move_base that have the parameter.
        low, high: Range in a robot's space, in the unit of its kind: share of what the base allows for a speed or turn,
            widths of the robot for a length.
        policy: Number of the output of a policy in the dimensionless encoding; 0 if only searches set the parameter.
        log: Whether that output is logarithmic.
        output: Range of the output in units of the encoding, if it differs from low and high.
        also: Second name in the same place that follows, with the opposite sign after "-".
        start: Value that move_base starts with if the files leave it out and it may lie outside of the range.
    """

    place: str
    name: str
    low: float
    high: float
    policy: int = 0
    log: bool = False
    output: Optional[Tuple[float, float]] = None
    also: str = ""
    start: Optional[float] = None

    @property
    def declared(self) -> Parameter:
        """Its declaration in the planner's tables."""
        return next(p for p in DECLARED[self.place] if self.name in p.names)


LEARNED = (  # in the order in which a space has them
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
    Learned(DWA, "min_vel_x", 0.0, 0.0, 11, output=(-1.0, 0.0)),
    Learned(LAYERS, "inflation_radius", 0.15, 3.0, 9, True, (0.18, 3.0), start=0.55),
    Learned(LAYERS, "cost_scaling_factor", 1.0, 20.0, 10, True, (0.5, 12.0)),
    Learned(TRAJECTORY, "min_in_place_vel_theta", 0.05, 0.5, start=0.4),
    Learned(TRAJECTORY, "escape_reset_dist", 0.25, 2.0, start=0.1),
    Learned(TRAJECTORY, "escape_reset_theta", 0.1, 3.14, start=1.57),
    Learned(BOTH_COSTMAPS, "footprint_padding", 0.0, 0.45, start=0.01),
    Learned(MOVE_BASE, "planner_frequency", 0.0, 5.0, start=0.0),
)
_rows = sorted((row for row in LEARNED if row.policy), key=lambda row: row.policy)
# Outputs of a policy in the dimensionless encoding, in their order, by the parameter's name; then by all of its names.
OUTPUTS = {row.name: row for row in _rows if row is next(first for first in _rows if first.policy == row.policy)}
NAMES = {
    known: name
    for name in OUTPUTS
    for row in _rows
    if row.policy == OUTPUTS[name].policy
    for known in row.declared.names
}


def default_space(base: Base, body: Body, tree: Dict[str, Any]) -> Tuple[SpaceParameter, ...]:
    """Return eleven to fifteen parameters of planners and costmaps; ranges include what the files start with.

    They are made without checks, because the tree has not been checked yet; check.py does so.

    Args:
        base: The robot's base, whose limits bound the speeds.
        body: Its body, whose width is the measure of lengths.
        tree: Its move_base parameters.
    """
    inflation: List[str] = []
    with suppress(ParameterError):  # which the check tells
        tree = arranged(tree)
        found_layers = [layer for name in COSTMAPS[::-1] for layer in layers(name, branch(tree, name))]
        inflation = [layer.path for layer in found_layers if layer.kind == INFLATION_LAYER]
    planner = namespace(str(tree.get("base_local_planner", TRAJECTORY)))
    places = {LAYERS: inflation, BOTH_COSTMAPS: list(COSTMAPS[::-1]), MOVE_BASE: [MOVE_BASE]}
    places[DWA if planner == DWA else TRAJECTORY] = [planner]
    left_out = {
        "min_vel_x": (number_at(tree, planner, ("min_vel_x",)) or 0.0)
        >= 0.0,  # no policy reverses where its maker does not
        "footprint_padding": len({number_at(tree, costmap, ("footprint_padding",)) for costmap in COSTMAPS}) > 1,
        "planner_frequency": bool(number_at(tree, MOVE_BASE, ("planner_frequency",))),  # else a plan is made once
    }
    units = {"speed": base.max_speed, "turn": base.max_yaw_rate, "length": max(body.size[1], base.track)}
    rows = (row for row in LEARNED if not left_out.get(row.name) and places.get(row.place))
    return tuple(_space_parameter(row, places[row.place], units, tree) for row in rows)


def _space_parameter(row: Learned, servers: List[str], units: Dict[str, float], tree: Dict[str, Any]) -> SpaceParameter:
    """A learnt parameter of these servers, whose range includes what a tree of parameters starts with."""
    p = row.declared
    settings = [Setting.model_construct(server=server, name=row.name, aliases=p.aliases) for server in servers]
    if row.also:
        negated = row.also.startswith("-")
        settings.append(Setting.model_construct(server=servers[0], name=row.also.lstrip("-"), negated=negated))
    low, high = (units.get(p.kind, 1.0) * end for end in (row.low, row.high))
    start = number_at(tree, servers[0], settings[0].names)
    start = row.start if start is None else start
    if start is not None:
        start = min(max(start, p.min), p.max)  # as move_base has it
        low, high = min(low, start), max(high, start)
    return SpaceParameter.model_construct(
        name=row.name, range=(low, high), integer=p.kind == "count", sets=tuple(settings), paper=row.policy > 0
    )
