"""Worlds of moving obstacles in the manner of DynaBARN: a room of 20 x 20 m that people and vehicles cross.

The course is DynaBARN's, 20 m straight through the room. Numbers go round its three kinds: slow, medium and fast.
"""

from __future__ import annotations

import math
from typing import List

import numpy as np

from .dynabarn import arena_course
from .world import KeyFrame, Mover, World

SPLITS = {"test": range(50), "validation": range(50, 100)}  # numbers from 100 on are free for training
SPEEDS = ((0.3, 0.95), (0.8, 1.5), (1.4, 1.95))  # of the three kinds [m/s]
COUNTS = ((6, 12), (8, 18), (10, 24))  # of their movers
RADII = (0.25, 0.5)  # of a person, and of DynaBARN's cylinders [m]
HALF, WALL = 10.0, 0.5  # half the room's side and the thickness of its walls [m]
WALLS = np.array([[-HALF, 0, 0, WALL, 2 * HALF], [0, HALF, 0, 2 * HALF, WALL], [0, -HALF, 0, 2 * HALF, WALL]])
SEED = 20220601


def generate(number: int) -> World:
    """World `number`; any number >= 0 gives one."""
    rng = np.random.default_rng([SEED, number])
    kind = number % len(SPEEDS)
    count = int(rng.integers(COUNTS[kind][0], COUNTS[kind][1] + 1))
    movers = tuple(_mover(rng, SPEEDS[kind]) for _ in range(count))
    return World(f"dynamic:{number}", np.empty((0, 3)), WALLS, arena_course(), movers)


def _mover(rng: np.random.Generator, speeds) -> Mover:
    """A cylinder from one wall to another through some points of the room, whose pace changes from leg to leg."""
    first, last = (_at_a_wall(rng, wall) for wall in rng.choice(4, 2, replace=False))
    between = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 6))))
    way = [first] + [first + u * (last - first) + rng.normal(0.0, 2.0, 2) for u in between] + [last]
    points = np.clip(way, -HALF, HALF)
    frames: List[KeyFrame] = [(0.0, float(points[0][0]), float(points[0][1]))]
    for before, after in zip(points[:-1], points[1:]):
        took = max(math.hypot(*(after - before)), 0.05) / rng.uniform(*speeds)
        frames.append((frames[-1][0] + took, float(after[0]), float(after[1])))
    return Mover(float(rng.uniform(*RADII)), tuple(frames))


def _at_a_wall(rng: np.random.Generator, wall: int) -> np.ndarray:
    along, side = rng.uniform(-0.9 * HALF, 0.9 * HALF), HALF if wall % 2 else -HALF
    return np.array([side, along] if wall < 2 else [along, side])
