"""BARN's recipe for worlds: random cells, smoothed by a cellular automaton, kept when a Jackal can pass.

`worlds.builtin` holds what this made for numbers 0 to 299; a test makes them again.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np
from scipy import ndimage

from . import barn_grid, search
from .world import World

FILL = (0.15, 0.20, 0.25, 0.30)  # probability that a cell is filled at first
ROUNDS = (2, 3, 4)  # rounds of smoothing
PER_KIND = 25  # worlds of each of the 12 kinds
COUNT = len(FILL) * len(ROUNDS) * PER_KIND
SEED = 20201103  # of the built-in set

_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])


def kind(number: int) -> Tuple[float, int]:
    """(fill probability, smoothing rounds) of world `number`: number = 25 (3 i_fill + rounds - 2) + k."""
    i_fill, i_rounds = divmod((number % COUNT) // PER_KIND, len(ROUNDS))
    return FILL[i_fill], ROUNDS[i_rounds]


def _neighbours(filled: np.ndarray, rows_outside: bool) -> np.ndarray:
    """How many of each cell's 8 neighbours are filled, (30, 30).

    Columns outside the field count as free, rows outside as `rows_outside`.
    """
    padded = np.pad(np.pad(filled, ((0, 0), (1, 1))), ((1, 1), (0, 0)), constant_values=rows_outside).astype(np.int64)
    return ndimage.convolve(padded, _NEIGHBOURS, mode="constant")[1:-1, 1:-1]


def smooth(filled: np.ndarray) -> np.ndarray:
    """One round, all cells at once: 5 or more filled neighbours fill a cell, 1 or fewer clear it.

    Rows outside count as filled, columns outside as free.
    """
    neighbours = _neighbours(filled, rows_outside=True)
    return (filled | (neighbours >= 5)) & (neighbours > 1)


def hollow(filled: np.ndarray) -> np.ndarray:
    """Without the cells that are enclosed on all 8 sides: BARN puts no cylinder where no robot or laser can tell."""
    return filled & (_neighbours(filled, rows_outside=False) < 8)


def draw_field(fill: float, rounds: int, rng: np.random.Generator) -> np.ndarray:
    """(30, 30) bool: a smoothed random field between two walls (rows 0 and 29), not yet hollowed."""
    filled = rng.random((barn_grid.ROWS, barn_grid.COLS)) < fill
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smooth(filled)
    return filled


def draw_path(filled: np.ndarray, rng: np.random.Generator) -> Optional[np.ndarray]:
    """(k, 2) cells from a random free row of the first column to one of the last, or None where there is no way.

    The largest region that touches the first column must be the largest that touches the last one.
    """
    free = search.free_space(filled, barn_grid.CLEARANCE)
    regions, _ = ndimage.label(free)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    start_region, goal_region = (regions[:, c][np.argmax(sizes[regions[:, c]])] for c in (0, -1))
    if start_region == 0 or start_region != goal_region:
        return None
    start = int(rng.choice(np.flatnonzero(regions[:, 0] == start_region)))
    goal = int(rng.choice(np.flatnonzero(regions[:, -1] == start_region)))
    return search.barn_path(free, (start, 0), (goal, barn_grid.COLS - 1))


def generate_field(number: int, seed: int = SEED) -> Tuple[np.ndarray, np.ndarray]:
    """(filled (30, 30) bool, hollowed; path (k, 2) int64 cells) of world `number`. Drawn until there is a path."""
    fill, rounds = kind(number)
    rng = np.random.default_rng([seed, number])
    while True:
        filled = draw_field(fill, rounds, rng)
        path = draw_path(filled, rng)
        if path is not None:
            return hollow(filled), path


def generate(number: int, seed: int = SEED) -> World:
    """World `number` of the set `seed`. Any number >= 0 gives a world; the recipe's kinds repeat every 300."""
    return barn_grid.make_world(f"generated:{number}", *generate_field(number, seed))
