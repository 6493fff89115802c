"""BARN's recipe for worlds: random cells, smoothed by a cellular automaton, kept when a Jackal can pass.
`worlds.builtin` holds what this made for numbers 0 to 299; a test makes them again."""
from __future__ import annotations

from typing import Tuple

import numpy as np
from scipy import ndimage

from . import field, search
from .world import World

FILL = (0.15, 0.20, 0.25, 0.30)      # probability that a cell is filled at first
ROUNDS = (2, 3, 4)                   # rounds of smoothing
PER_KIND = 25                        # worlds of each of the 12 kinds
COUNT = len(FILL) * len(ROUNDS) * PER_KIND
SEED = 20201103                      # of the built-in set

_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])


def kind(number: int) -> Tuple[float, int]:
    """(fill probability, smoothing rounds) of world `number`: number = 25 (3 i_fill + rounds - 2) + k."""
    i_fill, i_rounds = divmod((number % COUNT) // PER_KIND, len(ROUNDS))
    return FILL[i_fill], ROUNDS[i_rounds]


def smooth(filled: np.ndarray) -> np.ndarray:
    """One round, all cells at once: 5 or more filled neighbours fill a cell, 1 or fewer clear it.
    Rows outside count as filled, columns outside as free."""
    padded = np.pad(np.pad(filled, ((0, 0), (1, 1))), ((1, 1), (0, 0)), constant_values=True).astype(np.int64)
    neighbours = ndimage.convolve(padded, _NEIGHBOURS, mode="constant")[1:-1, 1:-1]
    return (filled | (neighbours >= 5)) & (neighbours > 1)


def draw_field(fill: float, rounds: int, rng: np.random.Generator) -> np.ndarray:
    """(30, 30) bool: a smoothed random field between two walls (rows 0 and 29)."""
    filled = rng.random((field.ROWS, field.COLS)) < fill
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smooth(filled)
    filled[[0, -1]] = True
    return filled


def draw_path(filled: np.ndarray, rng: np.random.Generator):
    """(k, 2) cells from a random free row of the first column to one of the last in the same region, or None."""
    free = search.free_space(filled, field.CLEARANCE)
    regions, _ = ndimage.label(free, structure=np.ones((3, 3)))
    starts = np.flatnonzero(np.isin(regions[:, 0], regions[free[:, -1], -1]) & free[:, 0])
    if not len(starts):
        return None
    start = int(rng.choice(starts))
    goal = int(rng.choice(np.flatnonzero(regions[:, -1] == regions[start, 0])))
    return search.shortest_path(free, (start, 0), (goal, field.COLS - 1))


def generate_field(number: int, seed: int = SEED):
    """(filled (30, 30) bool, path (k, 2) int64 cells) of world `number`; drawn again until there is a path."""
    fill, rounds = kind(number)
    rng = np.random.default_rng([seed, number])
    while True:
        filled = draw_field(fill, rounds, rng)
        path = draw_path(filled, rng)
        if path is not None:
            return filled, path


def generate(number: int, seed: int = SEED) -> World:
    """World `number` of the set `seed`. Any number >= 0 gives a world; the recipe's kinds repeat every 300."""
    return field.make_world("generated:%d" % number, *generate_field(number, seed))
