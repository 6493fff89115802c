"""All critics of DWAPlannerROS, in the order of the C++ planner.

A new critic needs its file (see this package), and its line in each of the lists below.
"""

from typing import NamedTuple, Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics import (
    alignment,
    goal,
    goal_front,
    obstacle,
    oscillation,
    path,
    twirling,
)
from applr_ros1.planner.dwa.critics.critic import CriticRow
from applr_ros1.planner.dwa.records import DWAGrids, DWAScene
from applr_ros1.planner.dwa.samples import ground_speed
from applr_ros1.planner.sampling_planner import Record, Velocity


class Critics(NamedTuple):
    """A number for each critic, in the order in which C++ asks them, under their names in C++."""

    oscillation: float
    obstacle: float
    goal_front: float
    alignment: float
    path: float
    goal: float
    twirling: float


CRITICS = Critics._fields
ALL = len(CRITICS)
NUMBERS = Critics(*range(ALL))  # number of each critic


@kernel
def weights(p: Record) -> Critics:
    """Return the critics' weights. A critic of weight 0 is not asked: it refuses nothing."""
    return Critics(
        oscillation=oscillation.weight(p),
        obstacle=obstacle.weight(p),
        goal_front=goal_front.weight(p),
        alignment=alignment.weight(p),
        path=path.weight(p),
        goal=goal.weight(p),
        twirling=twirling.weight(p),
    )


@kernel
def value(
    p: Record,
    state: Record,
    scene: DWAScene,
    grids: DWAGrids,
    points: Data,
    velocity: Velocity,
    critic: int,
) -> float:
    """Return the value of one critic, numbered as in NUMBERS, for a trajectory.

    points: poses (k, 3) of the trajectory; without any, the map's critics return 0. velocity: the
    velocity that the trajectory stores (samples.commanded).
    """
    if critic == NUMBERS.oscillation:
        return oscillation.value(state, velocity)
    if critic == NUMBERS.obstacle:
        return obstacle.value(p, scene, points, ground_speed(velocity.vx, velocity.vy))
    if critic == NUMBERS.goal_front:
        return goal_front.value(p, scene, grids, points)
    if critic == NUMBERS.alignment:
        return alignment.value(p, scene, grids, points)
    if critic == NUMBERS.path:
        return path.value(scene, grids, points)
    if critic == NUMBERS.goal:
        return goal.value(scene, grids, points)
    return twirling.value(velocity)


@kernel(inline="always")
def lower_bound(p: Record, known: Record, velocity: Velocity) -> float:
    """Return a lower bound of the weighted sum for a sample that no critic has refused so far.

    The order of the sum is that of total_cost, so that its roundings are the same.

    known: KNOWN record of the sample. velocity: see value.
    """
    cost = oscillation.bound(known) * oscillation.weight(p)
    cost += obstacle.bound(known) * obstacle.weight(p)
    cost += goal_front.bound(known) * goal_front.weight(p)
    cost += alignment.bound(known) * alignment.weight(p)
    cost += path.bound(known) * path.weight(p)
    cost += goal.bound(known) * goal.weight(p)
    cost += twirling.bound(velocity) * twirling.weight(p)
    return cost


def rows() -> Tuple[CriticRow, ...]:
    """Return the rows of all critics on the page, in the critics' order."""
    return (
        oscillation.ROW,
        obstacle.ROW,
        goal_front.ROW,
        alignment.ROW,
        path.ROW,
        goal.ROW,
        twirling.ROW,
    )
