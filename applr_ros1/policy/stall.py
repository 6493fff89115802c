"""Whether a robot has stalled: it has hardly moved for a while, as in a pocket where its planner turns on the spot.

In training a stall ends an episode as a failure, where that is asked for (training/env/episode.py). On the robot, and
in evaluation, it makes a policy's method change the parameters (actor.py).
"""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Optional, Tuple

WAY, SECONDS = 0.3, 8.0  # less than this way [m], at the Jackal's scale, in this time [s]


class Stall:
    """Watches one robot, decision after decision.

    Args:
        scale: The robot's size beside the Jackal's, by which the way is multiplied (Robot.world_scale).

    Attributes:
        share: The way of the last SECONDS in shares of what a robot must drive, 1 at most; 1 before so much time.
    """

    def __init__(self, scale: float):
        self.least = WAY * scale
        self.reset()

    def reset(self) -> None:
        """Begin a course."""
        self._driven, self.share = 0.0, 1.0
        self._last: Optional[Tuple[float, float]] = None
        self._seen: Deque[Tuple[float, float]] = deque()  # (time, way driven until then) of the decisions

    def look(self, time: float, x: float, y: float) -> bool:
        """Whether a robot that is at (x, y) [m] at `time` [s] has stalled."""
        if self._last is not None:
            self._driven += math.hypot(x - self._last[0], y - self._last[1])
        self._last = x, y
        self._seen.append((time, self._driven))
        while len(self._seen) > 1 and self._seen[1][0] <= time - SECONDS + 1e-6:
            self._seen.popleft()
        began, was = self._seen[0]
        if began <= time - SECONDS + 1e-6:
            self.share = min(1.0, (self._driven - was) / self.least)
        return self.share < 1.0
