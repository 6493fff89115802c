"""Answer of `./applr why` in words: what happened, why, what to change, and how sure that is."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from applr_ros1.common.paths import distances
from applr_ros1.why import alternatives
from applr_ros1.why.alternatives import Alternative
from applr_ros1.why.answer import (
    best_guess,
    certainty_of,
    indented,
    sentence,
    what_happened,
    what_the_planner_weighed,
)
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.events import Event, longest
from training.attempts.trials import SAME_PLACE_M, Tried, WholeDriveTrials

LISTED = 4  # number of further events, and of rows of what was tried
STOPS_S = 1.0  # time without motion that counts as a stop of a simulated drive [s]
STOPS_M = 0.05  # motion within it [m]


class Answer(NamedTuple):
    """Statements about a recorded drive.

    Attributes:
        diagnosis: What happened, and why.
        guesses: Alternatives that the replay ranks, the best first. They were not driven.
        trials: Whole drives; None if none were needed or possible.
    """

    diagnosis: Diagnosis
    guesses: Sequence[Alternative] = ()
    trials: Optional[WholeDriveTrials] = None


def lines_of(answer: Answer) -> List[str]:
    """Return the answer for a terminal: what happened, what to change, how sure, then the rest."""
    diagnosis = answer.diagnosis
    lines = [what_happened(diagnosis), *advice(answer), how_sure(answer)]
    lines += what_the_planner_weighed(diagnosis)
    lines += _other_events(diagnosis.events)
    return lines + tried_rows(answer)


def outside_lines(events: Sequence[Event], note: str) -> List[str]:
    """Return what is known of a drive that is not replayed, for a terminal.

    Args:
        events: Its events.
        note: Why it is not replayed.
    """
    longest_event = longest(events)
    if longest_event is None:
        return ["The robot did not stop.", f"{note}."]
    return [sentence(longest_event), f"{note}.", *_other_events(events)]


def _other_events(events: Sequence[Event]) -> List[str]:
    """Return lines with the longest events but one, the longest of all."""
    other_events = sorted(events, key=lambda event: -event.seconds)[1:]
    if not other_events:
        return []
    return ["Other events:", *indented(map(sentence, other_events[:LISTED]))]


def advice(answer: Answer) -> List[str]:
    """Return what to change, and what that did when it was driven.

    There is none for a drive without events, and for a moment that somebody asks about.
    """
    diagnosis = answer.diagnosis
    longest_event = diagnosis.longest
    if longest_event is None or longest_event.is_asked or diagnosis.part is not None:
        return []
    trials = answer.trials
    if trials is None and not diagnosis.wants_remedy:
        return ["No change was tried: the robot lost little time."]
    if trials is not None and trials.remedy is not None:
        remedy = trials.remedy
        return [f"Try {remedy.candidate}: {remedy}; with the recorded values {trials.recorded}."]
    sentences = []
    if trials is not None:
        seeds_in_words = " with each seed" if trials.judged else ""
        sentences.append(f"Nothing that was tried helped{seeds_in_words}.")
    guess = undriven_guess(answer)
    if guess is not None:
        sentences.append(f"The replay's guess: {guess.change}.")
    if not sentences:
        return []
    return [" ".join(sentences)]


def undriven_guess(answer: Answer) -> Optional[Alternative]:
    """Return what the replay ranks first, or None if it was driven in vain or gains too little."""
    guess = best_guess(answer.guesses, answer.diagnosis.replay)
    if guess is not None and answer.trials is not None:
        for tried in answer.trials.tried:
            if tried.candidate is not None and tried.candidate.changes == guess.changes:
                return None
    return guess


def how_sure(answer: Answer) -> str:
    """Return how far replay and simulated drives agree with the recorded one."""
    replay = answer.diagnosis.replay
    certainty = certainty_of(replay)
    longest_event = answer.diagnosis.longest
    if answer.trials is not None and longest_event is not None:
        reach = SAME_PLACE_M * replay.robot.world_scale
        stops = stops_near(answer.trials.recorded, longest_event, reach)
        stops_in_words = "stops there, too" if stops else "does not stop there"
        deciding_in_words = "with the recorded values"
        if answer.trials.policy_decided:
            deciding_in_words = "with its policy, which made the recorded decisions"
        certainty += f"; simulated {deciding_in_words}, the robot {stops_in_words}"
    return f"{certainty}."


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


def tried_rows(answer: Answer) -> List[str]:
    """Return rows of what was driven, and of what the replay alone ranks."""
    rows: List[str] = []
    if answer.trials is not None:
        rows += driven_rows(answer.trials)
    if answer.guesses:
        rows.append(f"{alternatives.heading(answer.diagnosis.replay)}:")
        rows += indented(answer.guesses[:LISTED])
    return rows


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
