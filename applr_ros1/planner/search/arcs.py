"""Poses and obstacle costs along an arc by closed forms, for lower bounds of a sample's cost.

The exact trajectories add up many small moves, with rounding errors that depend on the planner. A
closed form differs from them by less than a margin. Near a border of two cells, where this
difference may decide, the caller computes the exact pose or does without.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import UNSURE, Outline, outline_cost
from applr_ros1.planner.sampling_planner import Heading, Velocity, turned

# Largest turn per move in closed forms [rad]. The chord formula fails near a full turn.
LARGEST_TURN = 0.5
MOST_PARTS = 8  # number of parts of the finest division at which `probe` tests poses
FARTHER = 3.0  # length of a detour as a multiple of the straight distance


class Arc(NamedTuple):
    """Motion at a constant velocity, in moves of equal duration."""

    x: float  # position at the start [m]
    y: float
    heading: Heading  # direction at the start
    dx: float  # first move along the axes of the map [m]
    dy: float
    turn: float  # change of direction per move [rad], at most LARGEST_TURN


class ArcPose(NamedTuple):
    """Pose on an arc."""

    x: float  # [m]
    y: float
    heading: Heading


@kernel
def small_turn(a: float) -> Tuple[float, float]:
    """Return (cos a, sin a) from their series, accurate to about 1e-15 for |a| <= .25."""
    squared = a * a
    cos_a = 1 - squared / 2 * (1 - squared / 12 * (1 - squared / 30 * (1 - squared / 56)))
    sin_a = a * (1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42 * (1 - squared / 72))))
    return cos_a, sin_a


@kernel(inline="always")
def arc_from(x: float, y: float, heading: Heading, velocity: Velocity, dt: float) -> Arc:
    """Return the arc from a pose at a velocity of the base, in moves of dt [s]."""
    dx = (velocity.vx * heading.cos - velocity.vy * heading.sin) * dt
    dy = (velocity.vx * heading.sin + velocity.vy * heading.cos) * dt
    return Arc(x, y, heading, dx, dy, velocity.w * dt)


@kernel(inline="always")
def pose_after(arc: Arc, moves: int) -> ArcPose:
    """Return the pose after `moves` moves along an arc."""
    # The positions are corners of a regular polygon with the exterior angle `turn`. The chord over
    # several sides has the direction of the middle side, and by the law of sines it is as long as
    # sin(moves * half_turn) / sin(half_turn) sides.
    half_turn = 0.5 * arc.turn
    half_cos, half_sin = small_turn(half_turn)
    middle_cos = math.cos((moves - 1) * half_turn)
    middle_sin = math.sin((moves - 1) * half_turn)
    # sine and cosine of moves * half_turn, half the change of heading
    sin = middle_sin * half_cos + middle_cos * half_sin
    cos = middle_cos * half_cos - middle_sin * half_sin
    chord_sides = float(moves)
    if half_turn != 0.0:
        chord_sides = sin / half_sin
    x = arc.x + chord_sides * (arc.dx * middle_cos - arc.dy * middle_sin)
    y = arc.y + chord_sides * (arc.dy * middle_cos + arc.dx * middle_sin)
    heading = turned(arc.heading, Heading(1 - 2 * sin * sin, 2 * sin * cos))
    return ArcPose(x, y, heading)


@kernel(inline="always")
def probe(
    outline: Outline,
    arc: Arc,
    moves: int,
    shortest_part: int,
    margin: float,
    obstacle_cost: int,
    cost_limit: float,
) -> int:
    """Return a lower bound of the obstacle cost from a few poses, or -1 if one is illegal.

    The poses are the last one, then those at halves, quarters and eighths of the way: a sample that
    fails does so most often at its end.

    Args:
        outline: footprint of at least three vertices, and the map.
        arc: motion of the sample.
        moves: number of moves to its last pose.
        shortest_part: least number of moves between two probed poses. Closer poses take longer than
            they save.
        margin: distance to a border [cells] at which the cell of a vertex is certain.
        obstacle_cost: lower bound that is known already.
        cost_limit: cost above which the sample cannot win, so that the probe ends.
    """
    part_count = 1
    while part_count <= MOST_PARTS and moves // part_count >= shortest_part:
        # The even parts belong to the coarser division before.
        for i in range(1, part_count + 1, 2):
            pose = pose_after(arc, moves * i // part_count)
            cost = outline_cost(
                outline, pose.x, pose.y, pose.heading.cos, pose.heading.sin, 0, 0, margin
            )
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            obstacle_cost = max(obstacle_cost, cost)
            if obstacle_cost > cost_limit:
                return obstacle_cost
        part_count *= 2
    return obstacle_cost


@kernel(error_model="numpy")
def flood_reach(travel: float, resolution: float, cell_count: int) -> int:
    """Return how many steps further than the robot's cell a grid is flooded for the bounds.

    travel: longest way of the robot [m]. A diagonal metre is up to 1.42 m of 4-connected steps, and
    detours around obstacles are longer. Cells behind walls might require a flood of the whole map.
    """
    return int(min(FARTHER * travel / resolution, float(cell_count))) + 8
