"""Planner fidelity: this package's own planner, or one that reproduces defects of the C++ move_base.

"ours" is this package's planner. "cpp-like" also reproduces the defects of the C++ move_base that affect the success
rate (state_machine.py, recovery.py). "drawn" is a random choice between the two at each reset.
"""

from __future__ import annotations

import random
from typing import Sequence, Union

from applr_ros1.common.errors import ApplrError

OURS, CPP_LIKE, DRAWN = "ours", "cpp-like", "drawn"
PLANNERS = (OURS, CPP_LIKE)


def draw(planner: str, seed: Union[int, Sequence[int]]) -> str:
    """Return `planner`, or if it is "drawn", a random fidelity that depends only on the seed.

    Raises:
        ApplrError: `planner` is unknown.
    """
    if planner not in (*PLANNERS, DRAWN):
        raise ApplrError(f"planner {planner!r} is unknown: use {', '.join(PLANNERS)} or {DRAWN}")
    return generator(seed, 2).choice(PLANNERS) if planner == DRAWN else planner


def generator(seed: Union[int, Sequence[int]], stream: int) -> random.Random:
    """Return a random generator that depends on the seed and on its purpose, numbered by `stream`."""
    numbers = [seed] if isinstance(seed, int) else [int(n) for n in seed]
    return random.Random(f"{stream} of {numbers}")
