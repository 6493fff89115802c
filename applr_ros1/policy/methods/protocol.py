"""What a method is: the one interface of all that choose planner parameters, on the robot and in evaluation."""

from __future__ import annotations

from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.observation import LAYOUT, Layout
from applr_ros1.policy.parameter_space import SPACE, Space


class Method:
    """Chooses the planner's parameters at each decision.

    Attributes:
        name: The specification that it was made from.
        static: Whether theta is the same whatever the context is. The node asks a static method once, with None, and
            what a person changes later stands.
        period: Time [s] between two decisions.
        space: The parameters that it chooses. `make` gives it the robot's where it states none.
        layout: How it sees a scan: what Context.ranges and Context.observation are made with. `make` gives it the
            robot's where it states none.
        per_cell: Whether the distance biases of its sets are meant for a planner that counts per cell, as those of all
            learned sets here: the applr node then rescales them for a planner that counts per metre
            (policy/distance_weights.py). Otherwise they are sent as they are.
        stalls: Decisions so far that it made otherwise because the robot had stalled.
    """

    name = ""
    static = False
    period = PERIOD
    space: Space = SPACE
    layout: Layout = LAYOUT
    per_cell: bool = False
    stalls: int = 0

    def reset(self, seed: int) -> None:
        """Begin a course. Everything random is drawn from this seed only."""

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The parameters (n,) until the next decision. Raises ApplrError where there are none to be had."""
        raise NotImplementedError

    def describe(self) -> Dict[str, Any]:
        """What is recorded beside the results: two methods that describe themselves alike drive alike."""
        return {"class": type(self).__name__}
