"""The two kinds of planner: this package's own, and one with defects of the C++ move_base.

"ours"; "cpp-like" behaves as C++ where C++ has a defect that success depends on (state_machine.py, recovery.py);
"drawn" draws one of the two at each reset.
"""

from __future__ import annotations

import random

from applr_ros1.common.errors import ApplrError

OURS, CPP_LIKE, DRAWN = "ours", "cpp-like", "drawn"
PLANNERS = (OURS, CPP_LIKE)


def draw(planner: str, seed) -> str:
    """The kind of planner; "drawn" is decided by a seed, an int or a sequence of them. Raises ApplrError for others."""
    if planner not in (*PLANNERS, DRAWN):
        raise ApplrError(f"planner is {planner!r}: give {', '.join(PLANNERS)} or {DRAWN}")
    return generator(seed, 2).choice(PLANNERS) if planner == DRAWN else planner


def generator(seed, stream: int) -> random.Random:
    """A random generator of its own for each purpose (`stream`), from one seed (an int, or a sequence of them)."""
    numbers = [seed] if isinstance(seed, int) else [int(n) for n in seed]
    return random.Random(f"{stream} of {numbers}")
