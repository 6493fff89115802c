"""Page of one recorded drive: the answer, the drive, its events, and what was tried."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict

from applr_ros1.common.pages.page import Page

REPLAYED = (
    "The recorded drive was replayed through the local planner, cycle by cycle, on the map that "
    "the laser built."
)
DRIVEN = (
    "Changes were driven from the recorded start to the goal in simulation, in "
    "the world that the laser saw: a change is advised only if it is a tenth faster with seeds "
    "that did not choose it, and slower with none of them."
)
MARKS = Path(__file__).with_name("marks.js")
SCRIPTS = (MARKS, Path(__file__).with_name("why.js"))


def drive_page(values: Dict[str, Any], body: str = "") -> Page:
    """Return the page of a recorded drive.

    Args:
        values: Values of its answer (values_of).
        body: HTML above the answer.
    """
    driven_notes = [DRIVEN] if values["recorded"] is not None else []
    return Page(
        kind=f"why · {values['name']}",
        title="Why did the robot stop or slow down?",
        verdict=values["lines"][0],
        scripts=SCRIPTS,
        data=values,
        body=body,
        measured=[
            values["sure"],
            *values["evidence"],
            *values["notes"],
            REPLAYED,
            *driven_notes,
        ],
    )
