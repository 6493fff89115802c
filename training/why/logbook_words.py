"""Logbook in words: how much was lost, what to change, and where, why and when it was lost."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from datetime import datetime
from typing import Callable, DefaultDict, List, NamedTuple, Optional, Sequence

import numpy as np
from typing_extensions import override

from applr_ros1.why.answer import GUESSED, sentence, under
from applr_ros1.why.diagnosis import general
from training.common.words import counted
from training.why.common_change import CommonChange
from training.why.driven import driven_rows
from training.why.logbook import Logbook, LoggedStop, lost_in

WORST = 10  # number of stops in a list of the worst ones
LISTED = 8  # number of reasons, and of places, that are listed
UNKNOWN = "the reason is not known"
OUTSIDE = "outside the planner"
NO_GUESS = "no guess"


class LostTime(NamedTuple):
    """Stops that have something in common.

    Attributes:
        words: What they have in common.
        stops: The stops, the worst first.
    """

    words: str
    stops: List[LoggedStop]

    @property
    def lost(self) -> float:
        """Time that they cost [s]."""
        return lost_in(self.stops)

    @override
    def __str__(self) -> str:
        return f"{self.lost:.0f} s in {counted(len(self.stops), 'stop')}: {self.words}"


# -- groups ----------------------------------------------------------------------------------------
def by_reason(stops: Sequence[LoggedStop]) -> List[LostTime]:
    """Return stops by reason, whatever was measured in each of them."""
    groups = []
    for group in _grouped(stops, lambda logged: general(logged.stop.reason) or UNKNOWN):
        # Where all have the same reason, its numbers say more.
        reasons = {logged.stop.reason or UNKNOWN for logged in group.stops}
        groups.append(group._replace(words=reasons.pop()) if len(reasons) == 1 else group)
    return groups


def by_parameter(stops: Sequence[LoggedStop]) -> List[LostTime]:
    """Return stops by the parameter that the replay's best guess changes."""
    return _grouped(stops, parameter_of)


def by_day(stops: Sequence[LoggedStop]) -> List[LostTime]:
    """Return stops by day, in order of time. Those of simulated clocks have none."""
    dated_stops = [logged for logged in stops if logged.is_dated]
    return sorted(_grouped(dated_stops, day_of), key=lambda group: group.words)


def by_place(places: Sequence[List[LoggedStop]]) -> List[LostTime]:
    """Return the stops at each place."""
    return [LostTime(place_in_words(place[0]), place) for place in places]


def _grouped(stops: Sequence[LoggedStop], words_of: Callable[[LoggedStop], str]) -> List[LostTime]:
    """Return stops by some words, those that cost most time first."""
    groups: DefaultDict[str, List[LoggedStop]] = defaultdict(list)
    for logged in stops:
        groups[words_of(logged)].append(logged)
    lost_times = [LostTime(words, grouped_stops) for words, grouped_stops in groups.items()]
    return sorted(lost_times, key=lambda group: -group.lost)


def parameter_of(logged: LoggedStop) -> str:
    """Return the parameter that the replay's best guess changes, or why there is none."""
    if logged.stop.is_outside:
        return OUTSIDE
    guess = logged.bag.answer.guess
    return guess[0].path if guess else NO_GUESS


def day_of(logged: LoggedStop) -> str:
    """Return the day of a stop, by the clock here."""
    return datetime.fromtimestamp(logged.begin).strftime("%Y-%m-%d")


# -- sentences -------------------------------------------------------------------------------------
def headline(logbook: Logbook) -> str:
    """Return how much was lost, and when."""
    stops_in_words = counted(len(logbook.stops), "stop")
    drives_in_words = counted(len(logbook.bags), "drive")
    if not logbook.stops:
        return f"The robot did not stop in {drives_in_words}."
    sentence_begin = f"{stops_in_words} in {drives_in_words} cost {logbook.lost:.0f} s"
    days = by_day(logbook.stops)
    if not days:
        return f"{sentence_begin}."
    if len(days) == 1:
        return f"{sentence_begin}, on {days[0].words}."
    return f"{sentence_begin}, from {days[0].words} to {days[-1].words}."


def advice(logbook: Logbook, change: Optional[CommonChange]) -> List[str]:
    """Return what to change, and what that did when it was driven."""
    if not logbook.stops:
        return []
    sentences = []
    if change is not None:
        sentences.append(_change_in_words(change))
    outside = [logged for logged in logbook.stops if logged.stop.is_outside]
    if outside:
        listed = []
        for group in by_reason(outside):
            listed.append(f"{group.words} ({len(group.stops)})")
        stops_in_words = counted(len(outside), "stop")
        sentences.append(f"No parameter helps in {stops_in_words}: {'; '.join(listed)}.")
    return sentences


def _change_in_words(change: CommonChange) -> str:
    """Return what to change for the worst stops, and what it did there."""
    trials = change.trials
    worlds_in_words = f"{counted(len(change.bags), 'world')} of the worst stops"
    if trials.remedy is None:
        clearly = " clearly and in each world" if trials.judged else ""
        return f"Nothing that was tried in the {worlds_in_words} helped{clearly}."
    saved = sum(np.compress(change.helped, change.gains))
    # A whole drive in simulation may save more than the recorded stop cost.
    result = (
        f"whole drives take {saved:.0f} s less in {sum(change.helped)} of the {worlds_in_words}, "
        "and in none a tenth more"
    )
    return (
        f"Try {trials.remedy.candidate}: in simulation, {result}; {trials.remedy}, "
        f"with the recorded values {trials.recorded}."
    )


def how_sure(logbook: Logbook) -> str:
    """Return how far replays agree with the recorded drives."""
    sentence_parts = []
    if logbook.commands:
        share = logbook.reproduced / logbook.commands
        sentence_parts.append(
            f"{logbook.reproduced:,} of {logbook.commands:,} commands reproduced ({share:.1%})"
        )
    doubtful = sum(bag.answer.confidence == GUESSED for bag in logbook.bags)
    if doubtful:
        sentence_parts.append(
            f"few in {counted(doubtful, 'drive')}, whose planner's reasons are not to be trusted"
        )
    if not sentence_parts:
        return "No drive was replayed."
    sure = "; ".join(sentence_parts)
    return f"{sure[0].upper()}{sure[1:]}."


def place_in_words(worst_stop: LoggedStop) -> str:
    """Return where a place is."""
    answer = worst_stop.bag.answer
    x, y = worst_stop.position
    words = f"({x:.2f}, {y:.2f}) in {answer.frame}"
    return words if answer.is_shared else f"{words} (odometry since that start)"


def stop_in_words(logged: LoggedStop) -> str:
    """Return a stop with its bag."""
    event = replace(logged.stop, place=logged.position)
    return f"{event.lost:.0f} s: {logged.bag.path.name}, {sentence(event)}"


# -- terminal --------------------------------------------------------------------------------------
def lines_of(logbook: Logbook, change: Optional[CommonChange]) -> List[str]:
    """Return the logbook for a terminal."""
    lines = [headline(logbook), *advice(logbook, change), how_sure(logbook)]
    if not logbook.stops:
        return lines
    lines += under("Time lost by reason", by_reason(logbook.stops)[:LISTED])
    lines += under("By parameter of the replay's best guess", by_parameter(logbook.stops)[:LISTED])
    lines += under("By place", by_place(logbook.places)[:LISTED])
    lines += under("By day", by_day(logbook.stops)[:LISTED])
    lines += under("The worst stops", map(stop_in_words, logbook.stops[:WORST]))
    if change is not None:
        lines += driven_rows(change.trials)
    return lines
