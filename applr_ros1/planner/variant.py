"""What differs between one C++ move_base and the next, or between C++ and this package: a choice, never an accident.

MoveBase takes a Variant, the training environment and evaluation pass its two words on.

weights   In C++ the local planner reads `meter_scoring` from a member that nobody sets, so that path_distance_bias and
          goal_distance_bias count per metre or per cell by chance. "per_metre", "per_cell"; "drawn" draws one of the
          two at each reset; None obeys the parameter `meter_scoring`.
planner   "ours"; "cpp-like" behaves as C++ where C++ has a defect that success depends on (state_machine.py,
          recovery.py); "drawn" draws one of the two at each reset.
"""

from __future__ import annotations

import random
from typing import NamedTuple, Optional

from applr_ros1.common.errors import ApplrError

PER_METRE, PER_CELL, DRAWN = "per_metre", "per_cell", "drawn"
OURS, CPP_LIKE = "ours", "cpp-like"
WEIGHTS = (PER_METRE, PER_CELL)
PLANNERS = (OURS, CPP_LIKE)
DEFAULT_WEIGHTS = PER_CELL  # of simulation, demo and tables: nearer to Gazebo's times (docs/explanation/results.md)


class Variant(NamedTuple):
    """The two choices; see the module's docstring. `checked` raises ApplrError for other words."""

    weights: Optional[str] = None
    planner: str = OURS

    def checked(self) -> Variant:
        """Itself, if both words exist."""
        for what, word, known in (("weights", self.weights, WEIGHTS), ("planner", self.planner, PLANNERS)):
            if word not in known + (DRAWN,) and not (what == "weights" and word is None):
                raise ApplrError("%s is %r: give %s" % (what, word, ", ".join(known) + " or " + DRAWN))
        return self

    def draw(self, seed) -> Variant:
        """The same with whatever is "drawn" decided by a seed.

        Args:
            seed: an int, or a sequence of them. Equal seeds give equal choices; the two choices are independent.
        """
        weights = _one_of(WEIGHTS, seed, 1) if self.weights == DRAWN else self.weights
        planner = _one_of(PLANNERS, seed, 2) if self.planner == DRAWN else self.planner
        return Variant(weights, planner)


def generator(seed, stream: int) -> random.Random:
    """A random generator of its own for each purpose (`stream`), from one seed (an int, or a sequence of them)."""
    numbers = [seed] if isinstance(seed, int) else [int(n) for n in seed]
    return random.Random("%d of %s" % (stream, numbers))


def _one_of(choices, seed, stream: int) -> str:
    return generator(seed, stream).choice(choices)
