"""What the two planners that sample velocities share.

Called by trajectory/ and dwa/: angles as C++ ROS handles them, to the last bit; the check of new parameters; the heap
in which samples wait, the one with the least bound of its cost on top and of equal ones the first sampled; and the
display of a cycle's costs.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Mapping, Sequence, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.parameters.parameter import ParameterError

LARGEST_TURN = 0.5  # [rad] a step for closed forms: the chord's formula fails near a full turn


@kernel
def through_quaternion(yaw):
    """An angle after its way through a quaternion: in (-pi, pi], last bits may differ."""
    z = math.sin(yaw / 2)
    w = math.cos(yaw / 2)
    return math.atan2(2 * (w * z), w * w - z * z)


@kernel
def angle_difference(a, b):
    """The angle from a to b, in (-pi, pi]."""
    r = np.fmod(b - a + math.pi, 2.0 * math.pi)
    return r + math.pi if r <= 0.0 else r - math.pi


@kernel
def small_turn(a):
    """(cos a, sin a) by their series, for |a| <= .25 good to about 1e-15."""
    t = a * a
    return (
        1 - t / 2 * (1 - t / 12 * (1 - t / 30 * (1 - t / 56))),
        a * (1 - t / 6 * (1 - t / 20 * (1 - t / 42 * (1 - t / 72)))),
    )


def updated(
    values: Mapping[str, Any],
    changes: Mapping[str, Any],
    names: Sequence[str],
    above_zero: Sequence[str],
    not_negative: Sequence[str],
    samples: Sequence[str],
) -> Dict[str, Any]:
    """The values of a planner's parameters with some of them changed, checked.

    Args:
        values: what it has by now.
        changes: new values by name; names of no parameter of the planner are ignored.
        names: all parameters of the planner.
        above_zero: those of them that must be more than 0.
        not_negative: those that must be 0 or more.
        samples: those that are numbers of samples; values below 1 become 1.

    Raises:
        ParameterError: One line, for a value that is missing, not finite or out of its bound.
    """
    wanted = dict(values)
    wanted.update((name, changes[name]) for name in names if name in changes)
    for name in names:
        if name not in wanted:
            raise ParameterError(f"parameter {name} is missing: give the local planner a value")
        if not math.isfinite(wanted[name]):
            raise ParameterError(f"parameter {name} = {wanted[name]!r} is not a finite number")
    for name in (*above_zero, *not_negative):
        if wanted[name] < 0 or (wanted[name] == 0 and name in above_zero):
            bound = "above 0" if name in above_zero else "0 or more"
            raise ParameterError(f"parameter {name} = {wanted[name]!r} must be {bound}")
    wanted.update({name: max(int(wanted[name]), 1) for name in samples})
    return wanted


def cost_cloud(
    costmap: Any, path: np.ndarray, goal: np.ndarray, inside: np.ndarray, weights: Tuple[float, float, float]
) -> np.ndarray:
    """(k, 7) float32: x, y, z, path, goal, obstacle and total cost of cells, column by column, for display.

    Args:
        costmap: with cells (ny, nx), origin and resolution.
        path: (ny, nx) int32, distances to the plan in cells.
        goal: (ny, nx) int32, distances to the plan's end in cells.
        inside: (ny, nx) bool, the cells that are shown.
        weights: of path, goal and obstacle cost in the total.
    """
    column, row = np.nonzero(inside.T)
    cells = costmap.cells.T
    cloud = np.zeros((len(row), 7), np.float32)
    cloud[:, 0] = costmap.origin[0] + (column + 0.5) * costmap.resolution
    cloud[:, 1] = costmap.origin[1] + (row + 0.5) * costmap.resolution
    cloud[:, 3] = path.T[column, row]
    cloud[:, 4] = goal.T[column, row]
    cloud[:, 5] = cells[column, row]
    cloud[:, 6] = weights[0] * path.T[column, row] + weights[1] * goal.T[column, row] + weights[2] * cells[column, row]
    return cloud


@kernel
def sift_down(heap, keys, count, i):
    """Restore the heap of sample numbers, least (key, number) on top, after the key of heap[i] grew."""
    sample = heap[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _before(keys, heap[child + 1], heap[child]):
            child += 1
        if not _before(keys, heap[child], sample):
            break
        heap[i] = heap[child]
        i = child
    heap[i] = sample


@kernel
def _before(keys, a, b):
    return keys[a] < keys[b] or (keys[a] == keys[b] and a < b)
