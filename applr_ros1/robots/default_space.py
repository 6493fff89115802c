"""The parameter space of a robot whose robot.yaml states none: what pays, within wide ranges.

The first are what the included policy sets; the last ones, with paper false, are for searches alone. folder.py calls
`default_space`.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Dict, List, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import INFLATION
from applr_ros1.planner.parameters.declarations import SERVERS
from applr_ros1.planner.parameters.layers import COSTMAPS, INFLATION_LAYER, arranged, layers
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.robots.robot import Base, Body, Setting, SpaceParameter, setting

DWA = "DWAPlannerROS"
# what move_base starts with where the files leave it out, of those that the ranges would not always include
_DEFAULTS = {
    "vx_samples": 3.0,
    "forward_point_distance": 0.325,
    "inflation_radius": 0.55,
    "min_in_place_vel_theta": 0.4,
    "footprint_padding": 0.01,
    "planner_frequency": 0.0,
}


def default_space(base: Base, body: Body, tree: Dict[str, Any]) -> Tuple[SpaceParameter, ...]:
    """Eleven to fourteen parameters of planners and costmaps; ranges include what the files start with.

    They are made without checks, because the tree has not been checked yet; check.py does so.

    Args:
        base: The robot's base, whose limits bound the speeds.
        body: Its body, whose width is the measure of the inflation radius.
        tree: Its move_base parameters.
    """
    inflation: List[str] = []
    with suppress(ParameterError):  # which the check tells
        tree = arranged(tree)
        found_layers = [layer for name in COSTMAPS[::-1] for layer in layers(name, branch(tree, name))]
        inflation = [layer.path for layer in found_layers if layer.kind == INFLATION_LAYER]
    server = str(tree.get("base_local_planner", "TrajectoryPlannerROS")).rpartition("/")[2]
    dwa, speed, turn = server == DWA, base.max_speed, base.max_yaw_rate
    width = max(body.size[1], base.track)
    weight = (0.5, 64.0) if dwa else (0.05, 3.0)
    fast, side = ("max_vel_trans", "vth_samples") if dwa else ("", "vtheta_samples")
    mirrored = [] if dwa else [Setting.model_construct(server=server, name="min_vel_theta", negated=True)]
    ranges: List[Tuple[str, float, float, bool, List[Setting]]] = [
        ("max_vel_x", 0.1 * speed, speed, False, [Setting.model_construct(server=server, name=fast)] if fast else []),
        ("max_vel_theta", 0.1 * turn, turn, False, mirrored),
        ("vx_samples", 4.0, 20.0, True, []),
        (side, 4.0, 60.0, True, []),
        ("sim_time", 0.8, 3.0, False, []),
        ("occdist_scale", 0.005, 1.0, False, []),
        ("path_distance_bias", *weight, False, []),
        ("goal_distance_bias", *weight, False, []),
    ]
    if dwa:
        ranges.append(("forward_point_distance", 0.0, width, False, []))
        if (setting(tree, server, ("min_vel_x",)) or 0.0) < 0.0:  # no policy reverses where its maker does not
            ranges.append(("min_vel_x", 0.0, 0.0, False, []))
    aliases = {} if dwa else {"path_distance_bias": ("pdist_scale",), "goal_distance_bias": ("gdist_scale",)}
    found = []
    for name, low, high, whole, more in ranges:
        first = Setting.model_construct(server=server, name=name, aliases=aliases.get(name, ()))
        found.append(_with_start(tree, name, low, high, whole, (first, *more)))
    layered = (("inflation_radius", 0.15 * width, 3.0 * width), ("cost_scaling_factor", 1.0, 20.0))
    for name, low, high in layered if inflation else ():
        settings = tuple(Setting.model_construct(server=layer, name=name) for layer in inflation)
        found.append(_with_start(tree, name, low, high, False, settings))
    costmaps = ("local_costmap", "global_costmap")
    searched: List[Tuple[str, float, float, Tuple[str, ...]]] = []
    if not dwa:
        searched.append(("min_in_place_vel_theta", 0.05 * turn, 0.5 * turn, (server,)))
    if len({setting(tree, costmap, ("footprint_padding",)) for costmap in costmaps}) == 1:
        searched.append(("footprint_padding", 0.0, 0.45 * width, costmaps))
    if not setting(tree, "", ("planner_frequency",)):  # a plan is made once, through what the laser has not seen yet
        searched.append(("planner_frequency", 0.0, 5.0, ("",)))
    for name, low, high, places in searched:
        settings = tuple(Setting.model_construct(server=place, name=name) for place in places)
        found.append(_with_start(tree, name, low, high, False, settings, paper=False))
    return tuple(found)


def _with_start(
    tree: Dict[str, Any],
    name: str,
    low: float,
    high: float,
    integer: bool,
    settings: Tuple[Setting, ...],
    paper: bool = True,
) -> SpaceParameter:
    start = setting(tree, settings[0].server, settings[0].names)
    start = _DEFAULTS.get(name) if start is None else start
    if start is not None:
        for p in SERVERS.get(settings[0].server, INFLATION):
            start = min(max(start, p.min), p.max) if name in p.names else start  # as move_base has it
        low, high = min(low, start), max(high, start)
    return SpaceParameter.model_construct(name=name, range=(low, high), integer=integer, sets=settings, paper=paper)
