"""Unit of the distance biases in a parameter tree: costmap cells, as learned, or metres."""

from __future__ import annotations

from typing import Any, Dict


def counting_cells(parameters: Dict[str, Any]) -> Dict[str, Any]:
    """Return move_base's parameter tree with `meter_scoring` false.

    Distance biases learned here are per costmap cell. The applr node rescales them for a planner
    that needs biases per metre (applr_ros1/nodes/applr/meter_scoring.py).
    """
    planner = dict(parameters.get("TrajectoryPlannerROS", {}), meter_scoring=False)
    return dict(parameters, TrajectoryPlannerROS=planner)
