"""What whole drives found, as parts of the answer to a recorded drive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, List, Optional

import numpy as np

from applr_ros1.common.paths import distances
from applr_ros1.why.answer import LISTED, Answer, DriveValues, guess_in_words, thinned
from training.attempts.trials import SAME_PLACE_M, Arrival, Tried, WholeDriveTrials
from training.workers.calls import CallFailed

STOPS_S = 1.0  # time without motion that counts as a stop of a simulated drive [s]
STOPS_M = 0.05  # motion within it [m]
# Why a world does not count. In it, other values fail or help for reasons that the recorded drive
# did not have.
NOT_AS_FAR = "does not come as far as it did, so no advice rests on what was driven"


def with_trials(answer: Answer, trials: Optional[WholeDriveTrials]) -> Answer:
    """Return an answer with what whole drives found; as it is if there were none."""
    if trials is None:
        return answer
    stops = stops_near(trials.recorded, answer)
    # A remedy shows that the robot may pass in that world where it stopped in both.
    is_passable = stops and trials.remedy is not None
    if not is_passable and not comes_as_far(trials.recorded, answer):
        trials = trials._replace(remedy=None)
        result_in_words = NOT_AS_FAR
    else:
        result_in_words = "stops there, too" if stops else "does not stop there"
        answer = _advised(answer, trials)
        # What lies outside the planner is no parameter's effect, unless the simulation shows it.
        if stops or not answer.told.is_outside:
            first_line = answer.first_line + _likely_cause(trials.remedy)
            answer = replace(answer, first_line=first_line)
    deciding_in_words = "with the recorded values"
    if trials.policy_decided:
        deciding_in_words = "with its policy, which made the recorded decisions"
    simulated = f"simulated {deciding_in_words}, the robot {result_in_words}"
    return replace(
        answer,
        certainty=f"{answer.certainty}; {simulated}",
        driven=driven_rows(trials),
        **trials_values(trials),
    )


def _likely_cause(remedy: Optional[Tried]) -> str:
    """Return the unusual value without which drives are better, as a sentence; "" if none is."""
    if remedy is None or not remedy.candidate.replaces_unusual:
        return ""
    return f" Likely cause: {remedy.candidate.before}."


def _advised(answer: Answer, trials: WholeDriveTrials) -> Answer:
    """Return an answer with what to change, and what that did when it was driven."""
    for tried in trials.tried:
        # A guess that was driven in vain is none.
        if tried.candidate.changes == answer.guess:
            answer = replace(answer, guess=())
    remedy = trials.remedy
    if remedy is not None:
        result_in_words = f"the robot {remedy}; with the recorded values, it {trials.recorded}"
        advice = f"Try {remedy.candidate}: in simulation, {result_in_words}."
    else:
        clearly = " clearly" if trials.judged else ""
        advice = f"Nothing that was tried in simulation helped{clearly}."
        if answer.guess:
            advice += f" {guess_in_words(answer.guess[0])}"
    return replace(answer, advice=[advice])


def stops_near(tried: Tried, answer: Answer) -> bool:
    """Return whether one of the simulated drives stands where the event lies that is told."""
    reach = SAME_PLACE_M * answer.scale
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
        if (distances(stop_places, np.array(answer.told.place)) <= reach).any():
            return True
    return False


def comes_as_far(tried: Tried, answer: Answer) -> bool:
    """Return whether one of the simulated drives comes as near to the goal as the recorded one."""
    goal = np.array(answer.goal)
    track = np.array(answer.track)
    # On its way to another goal, the robot may have passed this one. A robot that was not heard of
    # any more has no track.
    pursuing = track[track[:, 0] >= answer.told.begin]
    recorded_distance = distances(pursuing[:, 1:3], goal).min(initial=np.inf)
    farthest = recorded_distance + SAME_PLACE_M * answer.scale
    for drive in tried.drives:
        if drive.success or distances(drive.path[:, 1:], goal).min() <= farthest:
            return True
    return False


def driven_rows(trials: WholeDriveTrials) -> List[str]:
    """Return rows of what was driven, the best first."""
    rows = [f"Driven in simulation ({trials.recorded} with the recorded values):"]
    judged = {entry.candidate: entry for entry in trials.judged}
    for tried in trials.tried[:LISTED]:
        table_row = f"   {tried.candidate}: {tried}"
        if tried.candidate in judged:
            table_row += f"; with other seeds {judged[tried.candidate]}"
        rows.append(table_row)
    return rows


def trials_values(trials: WholeDriveTrials) -> Dict[str, Any]:
    """Return remedies and all that was driven as JSON values, attributes of an answer."""
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
    return {
        "words": str(tried.candidate),
        "result": str(tried),
        "changes": list(map(list, tried.candidate.changes)),
        "arrivals": tried.arrivals,
        "drives": len(tried.drives),
        "seconds": round(tried.seconds, 2),
        "paths": [thinned(drive.path) for drive in tried.drives],
    }


def values_of_arrival(arrival: Arrival) -> DriveValues:
    """Return how a drive ended as an answer keeps it, with fewer positions."""
    return arrival.success, arrival.seconds, arrival.is_slow, thinned(arrival.path)


def arrival_from(values: Optional[DriveValues]) -> Arrival:
    """Return how a drive ended, or raise CallFailed if move_base refused its values."""
    if values is None:
        raise CallFailed("move_base refuses the values")
    success, seconds, is_slow, path = values
    return Arrival(success, seconds, is_slow, np.array(path, np.float32).reshape(-1, 3))
