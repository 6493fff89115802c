"""Common parts of all critics: the row on the page, and refusals."""

from typing import NamedTuple


class CriticRow(NamedTuple):
    """Row of a critic in the table of docs/explanation/planner_dwa.md."""

    critic: str
    weight: str
    value: str
    refuses: str


# Values of critics that refuse a trajectory
UNREACHED = -2.0
IN_OBSTACLE = -3.0
OFF_MAP = -4.0
OSCILLATES = -5.0
COLLIDES = -6.0
