"""Description of a critic, and the values that refuse a trajectory."""

from typing import NamedTuple, Optional

from applr_ros1.planner.sampling_planner import CostTerm


class GridReading(NamedTuple):
    """How a critic reads a distance grid at the points of a trajectory."""

    row: int  # row of the grid, see records.py
    at_nose: bool  # whether it is read forward_point_distance ahead of a point, or at the point
    refuses: bool  # whether a wall, or a cell that no flood has reached, refuses the trajectory


class Critic(NamedTuple):
    """A critic, except for its kernels.

    Attributes:
        term: Its part of the costs in the words of `why`. The name is that of the critic's file.
        scale: Field of PARAMETERS (records.py) with the weight; "" if the weight is 1.
        value: The value, on docs/explanation/planner_dwa.md.
        refuses: What it refuses, with the number of the refusal, on the same page.
        grid: How it reads a distance grid, or None if the file has a kernel `value`.
    """

    term: CostTerm
    scale: str
    value: str
    refuses: str
    grid: Optional[GridReading] = None


# Values of critics that refuse a trajectory
UNREACHED = -2.0
IN_OBSTACLE = -3.0
OFF_MAP = -4.0
OSCILLATES = -5.0
COLLIDES = -6.0
