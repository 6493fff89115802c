"""Answer of `./applr why` as JSON values, for programs and for its page."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.drives.drive import Drive
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.why import alternatives
from applr_ros1.why.answer import headline
from applr_ros1.why.events import Event
from applr_ros1.why.explanation import Explanation
from training.attempts.trials import Tried, WholeDriveTrials
from training.why.answer import Answer, advice, how_sure, lines_of

SCANS = 60  # number of scans in a page's map
CELL_M = 0.05  # distance of its points [m]
TRACK_S = 0.1  # interval between the positions of a driven path on a page [s]


def values_of(answer: Answer) -> Dict[str, Any]:
    """Return the diagnosis as JSON values, for programs and for the page."""
    diagnosis = answer.diagnosis
    replay = diagnosis.replay
    scans = replay.recording.scans
    # The map: points of some scans, one for each cell
    chosen_scans = np.linspace(0, len(scans) - 1, SCANS).astype(int)
    clouds = [replay.cloud(index).points[:, :2] for index in chosen_scans]
    cells = np.unique(np.rint(np.concatenate(clouds) / CELL_M), axis=0)

    # The measured motion, not the commands: a robot that stands may be told to drive.
    # Columns: time [s], x, y [m] in the odometry frame, forward speed [m/s]
    odometry = replay.recording.odometry
    track = np.column_stack([odometry.time, odometry.pose[:, :2], odometry.twist[:, 0]])

    event_values = []
    for event, explained in zip(diagnosis.events, diagnosis.explained):
        event_values.append(_event_values(event, explained))
    goal = diagnosis.goal
    plan = _first_plan(replay.drive)
    return {
        "name": replay.drive.name,
        "answer": lines_of(answer),
        "happened": headline(diagnosis),
        "advice": advice(answer),
        "sure": how_sure(answer),
        "reproduced": replay.share,
        "notes": replay.drive.notes,
        **trials_values(answer.trials),
        "alternatives": list(map(str, answer.guesses)),
        "alternatives_heading": alternatives.heading(replay),
        "events": event_values,
        "map": (cells * CELL_M).round(2).tolist(),
        "track": thinned(track),
        "top_speed": replay.top_speed,
        "plan": plan[:, :2].round(2).tolist(),
        "goal": goal.pose[:2] if goal is not None else None,
        "footprint": replay.planner.footprint(replay.settings).round(3).tolist(),
    }


def outside_values(drive: Drive, events: Sequence[Event], lines: Sequence[str]) -> Dict[str, Any]:
    """Return what is known of a drive that is not replayed as JSON values."""
    return {
        "name": drive.name,
        "answer": lines,
        "lines": lines,
        "happened": lines[0],
        "advice": [],
        "sure": lines[1],
        "reproduced": 0.0,
        "notes": drive.notes,
        "remedies": [],
        "alternatives": [],
        "events": [_event_values(event, ()) for event in events],
    }


def trials_values(trials: Optional[WholeDriveTrials]) -> Dict[str, Any]:
    """Return remedies and all that was driven as JSON values."""
    if trials is None:
        return {"remedies": [], "tried": [], "recorded": None}
    remedies = []
    if trials.remedy:
        remedies.append(str(trials.remedy.candidate))
    return {
        "remedies": remedies,
        "tried": list(map(_tried_values, trials.tried)),
        "recorded": _tried_values(trials.recorded),
    }


def _tried_values(tried: Tried) -> Dict[str, Any]:
    """Return what was driven with one candidate, or with the recorded values, as JSON values."""
    changes: Sequence[Change] = ()
    words = "recorded values"
    if tried.candidate is not None:
        changes = tried.candidate.changes
        words = str(tried.candidate)
    return {
        "words": words,
        "result": str(tried),
        "changes": list(map(list, changes)),
        "arrivals": tried.arrivals,
        "drives": len(tried.drives),
        "seconds": round(tried.seconds, 2),
        "paths": [thinned(drive.path) for drive in tried.drives],
    }


def thinned(track: np.ndarray, interval: float = TRACK_S) -> List[List[float]]:
    """Return rows of a track (n, k), whose first column is the time [s], one in each interval."""
    steps = np.floor(track[:, 0] / interval)
    _, first_rows = np.unique(steps, return_index=True)
    # float32 rows of a simulated path would be printed with all their digits.
    thinned = track[first_rows].astype(np.float64)
    rows: List[List[float]] = np.round(thinned, 2).tolist()
    return rows


def _first_plan(drive: Drive) -> np.ndarray:
    """Return the first plan (n, 3) to the goal, or that was followed; (0, 3) without a plan."""
    for plans in (drive.routes, drive.plans):
        if plans is not None:
            for plan_path in plans.path:
                if len(plan_path):
                    return plan_path
    return np.empty((0, 3))


def _event_values(event: Event, explained: Sequence[Explanation]) -> Dict[str, Any]:
    """Return an event and the explanations of its cycles as JSON values."""
    return {
        "title": str(event),
        "kind": event.kind,
        "begin": round(event.begin, 2),
        "end": round(event.end, 2),
        "reason": event.reason,
        "place": [round(coordinate, 3) for coordinate in event.place],
        "cycles": [explanation.values() for explanation in explained],
    }
