"""Planner fidelity: this package's own planner, or one that reproduces defects of C++.

"ours" is this package's planner. "cpp-like" also reproduces the defects of the C++ move_base that
affect the success rate (state_machine.py, recovery.py). "drawn" is a random choice between the two
at each reset.
"""

from __future__ import annotations

import random
from typing import Sequence, Union

from applr_ros1.common.errors import ApplrError

OURS = "ours"
CPP_LIKE = "cpp-like"
DRAWN = "drawn"
PLANNERS = (OURS, CPP_LIKE)

# Streams of generator(), one for each purpose
FIDELITY_STREAM = 2  # fidelity of a "drawn" planner
LATENESS_STREAM = 3  # cycles in which the planner thread of a C++-like planner is late


def draw(planner: str, seed: Union[int, Sequence[int]]) -> str:
    """Return `planner`, or if it is "drawn", a random fidelity that depends only on the seed.

    Raises:
        ApplrError: `planner` is unknown.
    """
    if planner == DRAWN:
        return generator(seed, FIDELITY_STREAM).choice(PLANNERS)
    if planner not in PLANNERS:
        known_planners = ", ".join(PLANNERS)
        raise ApplrError(f"planner {planner!r} is unknown: use {known_planners} or {DRAWN}")
    return planner


def generator(seed: Union[int, Sequence[int]], stream: int) -> random.Random:
    """Return a random generator that depends on the seed and on its purpose `stream`."""
    numbers = [seed] if isinstance(seed, int) else [int(number) for number in seed]
    # A text is hashed as a whole, so that neighbouring seeds and streams have nothing in common.
    return random.Random(f"{stream} of {numbers}")
