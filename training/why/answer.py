"""Answer of `./applr why` in words: what happened, why, what to change, and how sure that is."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.common.paths import distances
from applr_ros1.drives.drive import Drive
from applr_ros1.planner.parameters.settings import Change
from training.why.alternatives import Alternative
from training.why.diagnosis import ASKED, Diagnosis, goal_of, indented
from training.why.events import Event
from training.why.explanation import Explanation, beside
from training.why.whole_drives import SAME_PLACE_M, Trials, Tried

POOR = 0.8  # share of reproduced cycles below which a replay is not to be trusted
GUESS_SHARE = 0.1  # share of the top speed that a guess gains at least
LISTED = 4  # number of further events, and of rows of what was tried
SCANS = 60  # number of scans in a page's map
CELL_M = 0.05  # distance of its points [m]
TRACK_S = 0.1  # interval between the positions of a driven path on a page [s]
STOPS_S = 1.0  # time without motion that counts as a stop of a simulated drive [s]
STOPS_M = 0.05  # motion within it [m]


def lines_of(diagnosis: Diagnosis) -> List[str]:
    """Return the answer for a terminal: what happened, what to change, how sure, then the rest."""
    lines = [what_happened(diagnosis), *advice(diagnosis), how_sure(diagnosis)]
    longest_event = diagnosis.longest
    other_events = []
    for event in diagnosis.events:
        if event is not longest_event:
            other_events.append(event)
    other_events.sort(key=lambda event: -event.seconds)
    if other_events:
        lines.append("Other events:")
        lines += indented(map(sentence, other_events[:LISTED]))
    return lines + tried_rows(diagnosis)


def what_happened(diagnosis: Diagnosis) -> str:
    """Return the first line: where and when, what happened, and why."""
    if diagnosis.part is not None:
        place = beside(*diagnosis.part, digits=1)
        return f"The laser sees a part of the robot, {place} of its centre."
    if diagnosis.longest is not None:
        return sentence(diagnosis.longest)
    odometry = diagnosis.replay.recording.odometry
    top_speed = diagnosis.replay.top_speed
    mean_speed = float(np.abs(odometry.twist[:, 0]).mean())
    return (
        f"The robot did not stop: its mean speed is {mean_speed:.2f} m/s, "
        f"max_vel_x {top_speed:.2f} m/s."
    )


def headline(diagnosis: Diagnosis) -> str:
    """Return what happened as a sentence about the robot, for the top of a page."""
    event = diagnosis.longest
    if event is None or diagnosis.part is not None:
        return what_happened(diagnosis)
    happened = f"The robot {event.kind} from {event.begin:.1f} to {event.end:.1f} s"
    if not event.reason:
        return f"{happened}."
    return f"{happened}, because {event.reason}."


def sentence(event: Event) -> str:
    """Return an event with its reason."""
    if not event.reason:
        return f"{event}."
    return f"{event}, because {event.reason}."


def advice(diagnosis: Diagnosis) -> List[str]:
    """Return what to change, and what that did when it was driven.

    There is none for a drive without events, and for a moment that somebody asks about.
    """
    longest_event = diagnosis.longest
    if longest_event is None or longest_event.kind == ASKED or diagnosis.part is not None:
        return []
    trials = diagnosis.trials
    if trials is None and not diagnosis.wants_remedy:
        return ["No change was tried: the robot lost little time."]
    if trials is not None and trials.remedy is not None:
        remedy = trials.remedy
        return [f"Try {remedy.candidate}: {remedy}; with the recorded values {trials.recorded}."]
    sentences = []
    if trials is not None:
        seeds_in_words = " with each seed" if trials.judged else ""
        sentences.append(f"Nothing that was tried helped{seeds_in_words}.")
    guess = guess_of(diagnosis)
    if guess is not None:
        sentences.append(f"The replay's guess: {guess.change}.")
    if not sentences:
        return []
    return [" ".join(sentences)]


def guess_of(diagnosis: Diagnosis) -> Optional[Alternative]:
    """Return what the replay ranks first, or None if it was driven in vain or gains too little."""
    if not diagnosis.guesses:
        return None
    first_guess = diagnosis.guesses[0]
    if diagnosis.trials is not None:
        for tried in diagnosis.trials.tried:
            if tried.candidate is not None and tried.candidate.changes == first_guess.changes:
                return None
    if first_guess.gain < GUESS_SHARE * diagnosis.replay.top_speed:
        return None
    return first_guess


def how_sure(diagnosis: Diagnosis) -> str:
    """Return how far replay and simulated drives agree with the recorded one."""
    replay = diagnosis.replay
    certainty = str(replay)
    # Stops of move_base itself say nothing about the replay of the local planner.
    if replay.share_of_cycles < POOR:
        certainty += (
            "; few, so the planner's reasons are not to be trusted: "
            "parameters of the folder differ, or topics or scans are missing"
        )
    longest_event = diagnosis.longest
    if diagnosis.trials is not None and longest_event is not None:
        reach = SAME_PLACE_M * replay.robot.world_scale
        stops = stops_near(diagnosis.trials.recorded, longest_event, reach)
        stops_in_words = "stops there, too" if stops else "does not stop there"
        certainty += f"; simulated with the recorded values, the robot {stops_in_words}"
    return certainty + "."


def stops_near(tried: Tried, event: Event, reach: float) -> bool:
    """Return whether one of the simulated drives stands within reach [m] of an event."""
    for drive in tried.drives:
        # Where the robot is at each time, and STOPS_S later
        times = drive.path[:, 0]
        places = drive.path[:, 1:]
        later_rows = np.searchsorted(times, times + STOPS_S)
        has_later = later_rows < len(times)
        begin_places = places[has_later]
        end_places = places[later_rows[has_later]]

        moved_distances = distances(end_places, begin_places)
        stop_places = begin_places[moved_distances < STOPS_M]
        if (distances(stop_places, np.array(event.place)) <= reach).any():
            return True
    return False


def tried_rows(diagnosis: Diagnosis) -> List[str]:
    """Return rows of what was driven, and of what the replay alone ranks."""
    rows: List[str] = []
    trials = diagnosis.trials
    if trials is not None:
        rows.append(f"Driven in simulation ({trials.recorded} with the recorded values):")
        judged = {entry.candidate: entry for entry in trials.judged}
        for tried in trials.tried[:LISTED]:
            table_row = f"   {tried.candidate}: {tried}"
            if tried.candidate in judged:
                table_row += f"; with other seeds {judged[tried.candidate]}"
            rows.append(table_row)
    if diagnosis.guesses:
        rows.append("Guesses of the replay, two seconds ahead:")
        rows += indented(diagnosis.guesses[:LISTED])
    return rows


def values_of(diagnosis: Diagnosis) -> Dict[str, Any]:
    """Return the diagnosis as JSON values, for programs and for the page."""
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
    goal = goal_of(replay.drive)
    plan = _first_plan(replay.drive)
    return {
        "name": replay.drive.name,
        "answer": lines_of(diagnosis),
        "happened": headline(diagnosis),
        "advice": advice(diagnosis),
        "sure": how_sure(diagnosis),
        "reproduced": replay.share,
        "notes": replay.drive.notes,
        **_trials_values(diagnosis.trials),
        "alternatives": list(map(str, diagnosis.guesses)),
        "events": event_values,
        "map": (cells * CELL_M).round(2).tolist(),
        "track": _thinned(track),
        "top_speed": replay.top_speed,
        "plan": plan[:, :2].round(2).tolist(),
        "goal": goal[:2] if goal is not None else None,
        "footprint": replay.planner.footprint(replay.settings).round(3).tolist(),
    }


def _trials_values(trials: Optional[Trials]) -> Dict[str, Any]:
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
        "paths": [_thinned(drive.path) for drive in tried.drives],
    }


def _thinned(track: np.ndarray) -> List[List[float]]:
    """Return rows of a track (n, k), whose first column is the time [s], one in each TRACK_S."""
    steps = np.floor(track[:, 0] / TRACK_S)
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
